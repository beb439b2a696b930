"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const points = data.points;
const SVG = "http://www.w3.org/2000/svg";
const PLOT = { width: 860, height: 540, left: 62, right: 18, top: 16, bottom: 50 };
const $ = (id) => document.getElementById(id);
const state = { current: null, pinned: null, sort: { column: 2, rising: true } };

const methods = [...new Set(points.map((p) => p.method))];
const swatch = (p) => `var(--c${methods.indexOf(p.method) % 8})`;
const MB = (bytes) => bytes / 1e6;
const nice = (x, digits = 3) => (x === null ? "-" : Number(x.toPrecision(digits)).toString());
const fixed = (x) => (x === null ? "undefined" : x.toFixed(3));
const VIEWS = data.views;
const settingsText = (p) => [p.mode === "paper" ? "published settings" : "", ...Object.entries(p.settings).map(([k, v]) => `${k} ${v}`)].filter(Boolean).join(", ");
const title = (p) => `${data.names[p.method] || p.method}${settingsText(p) ? ", " + settingsText(p) : ""}`;
const detail = (p) => `${p.backbone}, ${VIEWS[p.view] || p.view}, ${p.presses} presses`;

function node(name, attributes = {}, parent = null, text = null) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  if (parent) parent.appendChild(made);
  return made;
}
function element(name, attributes = {}, parent = null, text = null) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) key === "style" ? (made.style.cssText = value) : made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  if (parent) parent.appendChild(made);
  return made;
}

// Filters

function chips(id, values, label, colour) {
  for (const value of values) {
    const chip = element("label", { class: "chip", style: colour ? `--swatch: ${colour(value)}` : "" }, $(id));
    const input = element("input", { type: "checkbox", value, "data-filter": id }, chip);
    input.checked = input.defaultChecked = true;
    element("span", {}, chip, label(value));
  }
}
const pressCounts = [...new Set(points.map((p) => p.presses))].sort((a, b) => a - b);
function makeFilters() {
  const unique = (key) => [...new Set(points.map((p) => p[key]))];
  chips("by-method", methods, (m) => data.names[m] || m, (m) => `var(--c${methods.indexOf(m) % 8})`);
  chips("by-backbone", unique("backbone"), (b) => b);
  chips("by-view", unique("view"), (v) => VIEWS[v] || v);
  chips("by-mode", unique("mode"), (m) => (m === "paper" ? "published" : "corrected"));
  const range = $("presses");
  range.max = pressCounts.length - 1;
  range.setAttribute("value", range.max);
  range.value = range.max;
  for (const [name, label] of Object.entries(data.measures)) element("option", { value: name }, $("measure"), label);
  $("filters").addEventListener("input", draw);
  $("filters").addEventListener("submit", (event) => event.preventDefault());
  $("filters").addEventListener("reset", () => setTimeout(draw));
}
function isShown(p) {
  const chosen = (id) => [...document.querySelectorAll(`[data-filter="${id}"]:checked`)].map((c) => c.value);
  const within = parseFloat($("within").value), under = parseFloat($("under").value);
  return chosen("by-method").includes(p.method) && chosen("by-backbone").includes(p.backbone) && chosen("by-view").includes(p.view)
    && chosen("by-mode").includes(p.mode) && p.presses <= pressCounts[$("presses").value]
    && !(p.ms > within) && !(MB(p.bank_bytes) > under) && accuracy(p)[0] !== null;
}
const accuracy = (p) => p.accuracy[$("measure").value];

// The front of the shown points, by the rule of the notes.
function onFront(shown) {
  const value = (p) => Number(accuracy(p)[0].toFixed(data.digits));
  const isBetter = (q, p) => value(q) >= value(p) && q.ms < p.ms || value(q) > value(p) && q.ms <= p.ms * (1 + data.margin);
  return shown.filter((p) => !shown.some((q) => isBetter(q, p)));
}

// Scales

function scales(shown) {
  const xs = shown.flatMap((p) => [p.floor_ms, p.ms]);
  const ys = shown.flatMap((p) => [accuracy(p)[0], ...(onFrontSet.has(p) ? accuracy(p).slice(1) : [])]).filter((v) => v !== null);
  const low = Math.log(Math.min(...xs) * 0.86), high = Math.log(Math.max(...xs) * 1.1);
  const [bottom, top] = [Math.min(...ys), Math.max(...ys)];
  const room = Math.max(top - bottom, 0.02) * 0.07;
  const y0 = Math.max(0, bottom - room), y1 = Math.min(1.005, top + room);
  const inner = { x: PLOT.width - PLOT.left - PLOT.right, y: PLOT.height - PLOT.top - PLOT.bottom };
  return {
    x: (v) => PLOT.left + inner.x * (Math.log(v) - low) / (high - low),
    y: (v) => PLOT.top + inner.y * (1 - (v - y0) / (y1 - y0)),
    xTicks: logTicks(Math.exp(low), Math.exp(high)), yTicks: ticks(y0, y1),
  };
}
function ticks(low, high) {
  const rough = (high - low) / 6, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].find((s) => s * power >= rough) * power;
  const found = [];
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9; v += step) found.push(v);
  return found;
}
function logTicks(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++)
    for (const m of [1, 2, 5]) if (m * 10 ** power >= low && m * 10 ** power <= high) found.push(m * 10 ** power);
  return found;
}

// The plot

let onFrontSet = new Set();
function symbol(p, x, y) {
  const r = 3.4 + 4.2 * Math.sqrt(p.presses / pressCounts[pressCounts.length - 1]);
  if (p.view === "lr") return `M${x - r},${y}a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0Z`;
  const s = r * 0.92;
  if (p.view === "hr") return `M${x - s},${y - s}h${2 * s}v${2 * s}h${-2 * s}Z`;
  return `M${x},${y - r * 1.25}L${x + r * 1.25},${y}L${x},${y + r * 1.25}L${x - r * 1.25},${y}Z`;
}
function stairs(found, s, xOf) {
  const sorted = [...found].sort((a, b) => xOf(a) - xOf(b) || accuracy(b)[0] - accuracy(a)[0]);
  let path = "", best = -Infinity;
  for (const p of sorted) {
    if (accuracy(p)[0] <= best) continue;
    path += path ? `H${s.x(xOf(p))}V${s.y(accuracy(p)[0])}` : `M${s.x(xOf(p))},${PLOT.height - PLOT.bottom}V${s.y(accuracy(p)[0])}`;
    best = accuracy(p)[0];
  }
  return path;
}
function drawPlot(shown) {
  const svg = $("plot");
  svg.replaceChildren();
  svg.classList.toggle("all-intervals", $("intervals").checked);
  if (!shown.length) {
    node("text", { x: PLOT.width / 2, y: PLOT.height / 2, "text-anchor": "middle" }, svg, "No point fits these filters. \u201cShow all\u201d brings them back.");
    return;
  }
  const s = scales(shown), bottom = PLOT.height - PLOT.bottom, right = PLOT.width - PLOT.right;
  const clip = node("clipPath", { id: "inside" }, node("defs", {}, svg));
  node("rect", { x: PLOT.left, y: PLOT.top - 8, width: right - PLOT.left + 8, height: bottom - PLOT.top + 8 }, clip);
  const edge = stairs(shown, s, (p) => p.floor_ms);
  const floor = node("g", { "clip-path": "url(#inside)" }, svg);
  node("path", { class: "floor", d: `${edge}V${PLOT.top - 8}H${PLOT.left}V${bottom}Z` }, floor);
  drawAxes(svg, s, bottom, right);
  node("path", { class: "floor-edge", d: edge }, floor);
  const zone = `translate(${PLOT.left + 15} ${(PLOT.top + bottom) / 2}) rotate(-90)`;
  node("text", { transform: zone, "text-anchor": "middle", class: "zone" }, svg, "faster than this machine can be");
  node("path", { class: "front", d: `${stairs([...onFrontSet], s, (p) => p.ms)}H${right}`, "clip-path": "url(#inside)" }, svg);
  const order = [...shown].sort((a, b) => a.ms - b.ms);
  const marks = node("g", { "clip-path": "url(#inside)" }, svg);
  const top = node("g", {}, svg);
  for (const p of order) drawPoint(p, s, onFrontSet.has(p) ? top : marks, order);
  node("g", { id: "overlay" }, svg);
  state.scale = s; state.order = order;
}
function drawAxes(svg, s, bottom, right) {
  const grid = node("g", { class: "grid" }, svg);
  for (const v of s.xTicks) {
    node("line", { x1: s.x(v), x2: s.x(v), y1: PLOT.top, y2: bottom }, grid);
    node("text", { x: s.x(v), y: bottom + 18, "text-anchor": "middle" }, svg, nice(v));
  }
  for (const v of s.yTicks) {
    node("line", { x1: PLOT.left, x2: right, y1: s.y(v), y2: s.y(v) }, grid);
    node("text", { x: PLOT.left - 8, y: s.y(v) + 4, "text-anchor": "end" }, svg, String(Number(v.toFixed(4))));
  }
  node("line", { class: "axis", x1: PLOT.left, x2: right, y1: bottom, y2: bottom }, svg);
  node("text", { x: (PLOT.left + right) / 2, y: PLOT.height - 8, "text-anchor": "middle" }, svg, "milliseconds from the settled frame to the verdict");
  node("text", { transform: `translate(16 ${(PLOT.top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, svg, data.measures[$("measure").value]);
}
function drawPoint(p, s, parent, order) {
  const x = s.x(p.ms), y = s.y(accuracy(p)[0]);
  const kinds = ["point", onFrontSet.has(p) ? "on-front" : "dominated", p.is_int8 ? "hollow" : ""].filter(Boolean);
  const g = node("g", { class: kinds.join(" "), tabindex: "-1", role: "img", "data-key": p.key, style: `--swatch: ${swatch(p)}`,
    "aria-label": `${title(p)}, ${detail(p)}: ${data.measures[$("measure").value]} ${fixed(accuracy(p)[0])}, ${nice(p.ms)} ms` }, parent);
  if (accuracy(p)[1] !== null) node("line", { class: "whisker", x1: x, x2: x, y1: s.y(accuracy(p)[1]), y2: s.y(accuracy(p)[2]) }, g);
  node("circle", { class: "hit", cx: x, cy: y, r: 11 }, g);
  node("circle", { class: "ring", cx: x, cy: y, r: 12 }, g);
  node("path", { class: "mark", d: symbol(p, x, y) }, g);
  g.addEventListener("pointerenter", () => show(p));
  g.addEventListener("pointerleave", () => show(state.pinned));
  g.addEventListener("focus", () => show(p));
  g.addEventListener("click", () => pin(p));
  g.addEventListener("keydown", (event) => walk(event, p, order));
}
function walk(event, p, order) {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  if (step) {
    const next = order[(order.indexOf(p) + step + order.length) % order.length];
    markOf(next).focus();
  } else if (event.key === "Enter" || event.key === " ") pin(p);
  else if (event.key === "Escape") pin(null);
  else return;
  event.preventDefault();
}
const markOf = (p) => document.querySelector(`.point[data-key="${CSS.escape(p.key)}"]`);

// The card

function pin(p) {
  state.pinned = state.pinned === p ? null : p;
  show(state.pinned || p);
}
function show(p) {
  p = p || state.best;
  state.current = p;
  for (const one of document.querySelectorAll(".current")) one.classList.remove("current");
  for (const one of document.querySelectorAll(".point")) {
    const isCurrent = p && one.dataset.key === p.key;
    one.setAttribute("tabindex", isCurrent ? "0" : "-1");
    one.classList.toggle("pinned", Boolean(state.pinned && one.dataset.key === state.pinned.key));
  }
  $("card").replaceChildren();
  if (!p) return;
  for (const one of document.querySelectorAll(`[data-key="${CSS.escape(p.key)}"]`)) one.classList.add("current");
  drawFloorMark(p);
  drawCard(p);
}
function drawFloorMark(p) {
  const overlay = $("overlay");
  if (!overlay || !markOf(p)) return;
  overlay.replaceChildren();
  const y = state.scale.y(accuracy(p)[0]), x = state.scale.x(p.floor_ms);
  node("line", { class: "floor-mark", x1: x, x2: state.scale.x(p.ms), y1: y, y2: y }, overlay);
  node("line", { class: "floor-mark", "stroke-dasharray": "none", x1: x, x2: x, y1: y - 5, y2: y + 5 }, overlay);
}
function drawCard(p) {
  const card = $("card");
  card.style.setProperty("--swatch", swatch(p));
  element("h3", {}, card, title(p));
  element("p", { class: "what" }, card, detail(p) + (onFrontSet.has(p) ? ". On the front." : "."));
  if (p.note) element("p", { class: "note" }, card, p.note);
  const facts = element("dl", {}, card);
  const fact = (name, value, small = "") => {
    element("dt", {}, facts, name);
    element("dd", {}, facts, value);
    element("dd", { class: "more" }, facts, small);
  };
  for (const name of Object.keys(data.measures)) {
    const [value, low, high] = p.accuracy[name];
    fact(data.short[name], fixed(value), low === null ? "" : `${low.toFixed(2)} to ${high.toFixed(2)}`);
  }
  fact("to the verdict", `${nice(p.ms)} ms`);
  fact("floor", `${nice(p.floor_ms)} ms`, `by ${p.binds}`);
  fact("bank", `${nice(MB(p.bank_bytes))} MB`, `${nice(MB(p.bank_bytes_unpacked))} in use`);
  fact("peak memory", p.peak_memory_bytes === null ? "not shown" : `${nice(MB(p.peak_memory_bytes))} MB`);
  fact("fit", `${nice(p.fit_s[0] + p.fit_s[1])} s`, `${nice(100 * p.gel_share)} % of a gel`);
  stack(p, card, p.ms);
  element("p", { class: "stack-text" }, card, data.stages.map((name, k) => `${name} ${nice(p.stages[k], 2)}`).join(" \u00b7 ") + " ms");
  element("pre", {}, card, p.command);
  const copy = element("button", { type: "button", style: "margin-top: 8px" }, card, "Copy the command");
  copy.addEventListener("click", () => navigator.clipboard && navigator.clipboard.writeText(p.command).then(() => (copy.textContent = "Copied")));
  element("p", { class: "hash" }, card, `trunk, head and bank: ${p.content_sha256}`);
}
function stack(p, parent, full) {
  const bar = element("div", { class: "stack", role: "img", "aria-label": data.stages.map((name, k) => `${name} ${nice(p.stages[k], 2)} ms`).join(", ") }, parent);
  p.stages.forEach((ms, k) => element("i", { style: `width: ${100 * ms / full}%; background: var(--s${k})` }, bar));
  element("b", { style: `left: ${Math.min(100, 100 * p.floor_ms / full)}%` }, bar);
}
function drawBars(found) {
  const sorted = [...found].sort((a, b) => a.ms - b.ms);
  const full = Math.max(...sorted.map((p) => p.ms));
  $("bars").replaceChildren();
  for (const p of sorted) {
    const bar = element("button", { type: "button", class: "bar", "data-key": p.key }, $("bars"));
    element("span", { class: "label" }, bar, `${title(p)} \u2013 ${detail(p)}`);
    stack(p, bar, full);
    element("em", {}, bar, `${nice(p.ms)} ms`);
    bar.addEventListener("pointerenter", () => show(p));
    bar.addEventListener("focus", () => show(p));
    bar.addEventListener("click", () => pin(p));
  }
}

// The table

const COLUMNS = [
  ["point", (p) => title(p) + ", " + detail(p), (v) => v], ["front", (p) => (onFrontSet.has(p) ? "yes" : ""), (v) => v],
  ["ms", (p) => p.ms, nice], ["floor ms", (p) => p.floor_ms, nice],
  ...Object.entries(data.measures).map(([name]) => [data.short[name], (p) => p.accuracy[name][0], fixed]),
  ["bank MB", (p) => MB(p.bank_bytes), nice], ["memory MB", (p) => p.peak_memory_bytes === null ? null : MB(p.peak_memory_bytes), nice],
  ["fit s", (p) => p.fit_s[0] + p.fit_s[1], nice], ["presses", (p) => p.presses, String],
];
function drawTable(shown) {
  const head = element("tr");
  COLUMNS.forEach(([name], k) => {
    const cell = element("th", k === state.sort.column ? { "aria-sort": state.sort.rising ? "ascending" : "descending" } : {}, head);
    element("button", { type: "button" }, cell, name).addEventListener("click", () => {
      state.sort = { column: k, rising: state.sort.column === k ? !state.sort.rising : true };
      drawTable(shown);
    });
  });
  $("table").tHead.replaceChildren(head);
  const value = COLUMNS[state.sort.column][1], sign = state.sort.rising ? 1 : -1;
  const sorted = [...shown].sort((a, b) => sign * (value(a) > value(b) ? 1 : value(a) < value(b) ? -1 : 0));
  $("table").tBodies[0].replaceChildren(...sorted.map((p) => {
    const row = element("tr", { "data-key": p.key, class: onFrontSet.has(p) ? "on-front" : "" });
    COLUMNS.forEach(([, of, write]) => element("td", {}, row, write(of(p))));
    row.addEventListener("pointerenter", () => show(p));
    return row;
  }));
}

function draw() {
  const shown = points.filter(isShown);
  const front = onFront(shown);
  onFrontSet = new Set(front);
  const most = pressCounts[$("presses").value];
  $("presses-out").textContent = `${most} (${nice(100 * most / data.gel_presses)} % of a gel)`;
  state.best = front.reduce((best, p) => (best === null || accuracy(p)[0] > accuracy(best)[0] ? p : best), null);
  if (state.pinned && !shown.includes(state.pinned)) state.pinned = null;
  drawPlot(shown);
  drawBars(front);
  drawTable(shown);
  $("caption").textContent = `${shown.length} of ${points.length} points, ${front.length} on the front (line). Larger marks used more presses; circles are ${VIEWS.lr}, `
    + "squares the high resolution in one piece, diamonds in tiles; hollow marks have an int8 trunk. Arrow keys walk through the points, Enter holds one.";
  show(state.pinned || state.best);
}
$("subtitle").textContent = data.subtitle;
data.stages.forEach((name, k) => {
  const entry = element("span", {}, $("legend"));
  element("i", { style: `background: var(--s${k})` }, entry);
  entry.append(name);
});
for (const text of data.notes) element("p", {}, $("notes"), text);
makeFilters();
draw();
