"use strict";
// Everything is set as text, never as HTML: a part's name is what a person has typed.
// The gateway answers within 5 s, also without news.
const AGAIN_MS = 1000, SILENT_MS = 8000, FRESH_MS = 300, LOCK_AFTER_MS = 5 * 60 * 1000;
const at = (id) => document.getElementById(id);
const word = (press) => press.verdict || "error";
// The text in the language of the page, by the English one; values stand in braces.
let translations = {};
const t = (text, values = {}) => (translations[text] || text).replace(/\{(\w+)\}/g, (all, name) => values[name]);

// A sentence of the station has names and numbers in it, and other sentences: its pattern is found by the words between
// them. Several are joined by "; ". What has no pattern stays English.
let patterns = []; // [what stands between, name, between, ...], the longest first
const LONGEST = 2000;
function match(parts, sentence) {
  const last = parts.length - 1, end = sentence.length - parts[last].length, values = {};
  if (!sentence.startsWith(parts[0]) || !sentence.endsWith(parts[last])) { return null; }
  for (let n = 1, from = parts[0].length; n < last; n += 2) {
    const to = n + 1 === last ? end : sentence.indexOf(parts[n + 1], from);
    if (to < from) { return null; }
    values[parts[n]] = tell(sentence.slice(from, to));
    from = to + parts[n + 1].length;
  }
  return last || !end ? values : null;
}
function tellOne(sentence) {
  for (const [pattern, parts] of patterns) {
    const values = match(parts, sentence);
    if (values) { return t(pattern, values); }
  }
  return null;
}
function tell(sentence) {
  if (!sentence || sentence.length > LONGEST) { return sentence; }
  for (let end = sentence.length; end > 0; end = sentence.lastIndexOf("; ", end - 1)) {
    const said = tellOne(sentence.slice(0, end));
    if (said !== null) { return said + (end < sentence.length ? `; ${tell(sentence.slice(end + 2))}` : ""); }
  }
  const sign = sentence.search(/[;:] /);
  return sign < 0 ? sentence : sentence.slice(0, sign + 2) + tell(sentence.slice(sign + 2));
}
const put = (id, text) => { if (at(id).textContent !== text) { at(id).textContent = text; } };

let shown = null; // the newest answer of live.json
let shownPress = null; // whose verdict is large
let key = null; // { token, by } while this page is unlocked; it is kept nowhere else
let lockTimer = 0;
const drawn = new Map(); // what each list shows, so that one which stays is left alone: somebody may have the focus in it

function element(tag, text, name) {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = name || "";
  return made;
}

function draw(id, facts, make) {
  const now = JSON.stringify(facts);
  if (drawn.get(id) !== now) {
    drawn.set(id, now);
    at(id).replaceChildren(...make());
  }
}

// With its day, where that is another one.
function clock(press) {
  const then = new Date(press.time_ms), isToday = then.toDateString() === new Date().toDateString();
  return isToday ? then.toLocaleTimeString("en-GB") : then.toLocaleString("sv-SE");
}

// A press of before the start is none of a part that lies there now.
const lastOf = (presses) => presses.find((press) => !press.is_earlier);

// With as many digits as it needs to differ from the threshold.
function ratio(press) {
  const score = press.score_ratio;
  if (typeof score !== "number") { return ""; }
  let digits = 2;
  while (score !== 1 && Number(score.toFixed(digits)) === 1 && digits < 17) { digits += 1; }
  return score.toFixed(digits);
}

const named = (one) => [one.part, one.position].filter(Boolean).join("/");
const may = (verb) => key !== null && shown !== null && shown.changes.verbs.includes(verb);

// What is typed is between backquotes.
const words = (text) => text.split("`").map((part, n) => element(n % 2 ? "code" : "span", part));

function showAlarm(alarm) {
  const row = element("div", "", `alarm ${alarm.severity}`), about = element("p", "");
  if (translations[alarm.title]) { about.append(element("strong", t(alarm.title)), document.createElement("br")); }
  about.append(...words(tell(alarm.text)));
  if (alarm.what_to_do) {
    const todo = element("strong", `${t("What to do:")} `);
    todo.append(...words(t(alarm.what_to_do)));
    about.append(document.createElement("br"), todo);
  }
  row.append(about);
  if (alarm.can_acknowledge && may("acknowledge_alarm")) {
    const button = element("button", t("Acknowledge"));
    button.setAttribute("aria-label", t("Acknowledge the alarm {alarm}", alarm));
    button.onclick = () => change(button, "acknowledge_alarm", { alarm: alarm.alarm }, () => t("The alarm {alarm} is acknowledged.", alarm));
    row.append(button);
  }
  return row;
}

// As many as stand in one row, one on a phone, the most serious first. A line names the others, and opens: they do not push the press away.
const isWarning = (alarm) => Number(alarm.severity === "warning");
const alarmsInRow = () => Math.min(3, Math.max(1, Math.floor(innerWidth / 468)));
function showAlarms(alarms, most) {
  const sorted = [...alarms].sort((one, other) => isWarning(one) - isWarning(other)), rest = sorted.slice(most);
  if (!rest.length) { return sorted.map(showAlarm); }
  const more = document.createElement("details"), count = rest.length === 1 ? t("1 more alarm") : t("{n} more alarms", { n: rest.length });
  more.open = at("alarms").querySelector("details")?.open || false;
  more.append(element("summary", `${count}: ${rest.map((alarm) => t(alarm.title || alarm.alarm)).join("; ")}`), ...rest.map(showAlarm));
  return [...sorted.slice(0, most).map(showAlarm), more];
}

// A pass is that of one place: what is large is the piece, and what is to be pressed now stands below it.
const count = (piece) => t("{n} of {all}", { n: piece.places.filter((place) => place.verdict).length, all: piece.places.length });
function large(press, piece) {
  if (piece && piece.piece_id !== null && press.piece_id && press.piece_id !== piece.piece_id) { return count(piece); }
  if (word(press) !== "pass") { return word(press); }
  if (!piece) { return press.place || "pass"; } // its message is on its way, or a broker refuses it
  if (piece.piece_id === null && piece.last_id !== null && piece.last_id === press.piece_id) { return piece.last_verdict; }
  return piece.places.some((place) => place.verdict === "fail") ? "fail" : count(piece);
}

function showPiece(piece) {
  at("pieces").hidden = !piece;
  at("begin").hidden = !piece || !may("begin_piece");
  put("todo", piece ? t("Press: {places}", { places: piece.expected.join(` ${t("or")} `) }) : "");
  if (!piece) { return; }
  put("piece", piece.piece_id !== null ? `${piece.piece_id}: ${t("{count} places pressed", { count: count(piece) })}`
    : piece.last_id !== null ? `${t("none in progress")}; ${piece.last_id}: ${t(piece.last_verdict)}` : t("none in progress"));
  draw("places", piece.places, () => piece.places.map((place) =>
    element("li", `${named(place)}: ${place.verdict ? t(place.verdict) : t("to be pressed")}`, place.verdict || "open")));
}

// What a hand should do. The station says it again five times a second: what is older than a second is not so any more.
const ADVICE = { deeper: () => t("Press deeper"), shift: () => t("Shift the part"), tilt: () => t("Press this side more"),
  hold: () => t("Hold still"), lift: () => t("Lift"), overload: () => t("Too deep: take it off") };
const SAID_MS = 1000;
let handTimer = 0, handAt = null;
function showHand(contact, isReady) {
  const advice = isReady && contact && ADVICE[contact.state === "overload" ? "overload" : contact.guidance];
  if (!advice) { handAt = null; at("hand").hidden = true; return; }
  if (contact.time_ms === handAt) { return; }
  handAt = contact.time_ms;
  clearTimeout(handTimer);
  handTimer = setTimeout(() => { at("hand").hidden = true; }, SAID_MS);
  const way = contact.direction_deg;
  at("hand").className = contact.state;
  at("arrow").hidden = typeof way !== "number";
  at("arrow").style.transform = `rotate(${way || 0}deg)`;
  put("advice", advice());
  at("hand").hidden = false;
}

function showGel(gel) {
  if (!gel) { put("gel", t("not known yet")); return; }
  const left = Math.max(0, gel.limit_presses - gel.presses), share = Math.min(100, 100 * gel.presses / gel.limit_presses);
  put("gel", t("{gel_id}: {presses} of {limit_presses} presses, {left} left: {state}", { ...gel, left, state: t(gel.state) })
    + [[t("serial"), gel.gel_serial], [t("type"), gel.gel_type], [t("use by"), gel.use_by]].map(([name, said]) => said ? `, ${name} ${said}` : "").join(""));
  at("worn").style.width = `${share}%`;
  at("worn").className = gel.state;
  at("life").setAttribute("aria-valuenow", Math.round(share));
  at("life").setAttribute("aria-valuetext", at("gel").textContent);
  put("old-gel", t("{gel_id} with {presses} presses is put away.", gel));
}

function showPart(info) {
  const parts = info.parts || [], now = named(info);
  put("selected", now);
  put("part", now ? [now, info.method, info.revision && t("revision {revision}", info)].filter(Boolean).join(" · ") : t("not known yet"));
  const drawn = info.region_names || [], mayDraw = may("set_regions");
  put("ignored", info.regions ? t("Drawn: {regions}", { regions: ofRegions(info.regions) }) : "");
  draw("regions", [drawn, mayDraw], () => drawn.map((name) => showRegion(name, mayDraw)));
  at("draw-region").hidden = !mayDraw || !info.field_mm || !shown.presses.some((press) => press.has_picture);
  const unproven = (info.warnings || []).filter((said) => said.startsWith("not proven"));
  draw("unproven", unproven, () => unproven.map((said) => element("li", said)));
  draw("parts", [parts, now], () => parts.map((name) => {
    const option = element("option", name);
    option.value = name;
    option.selected = name === now;
    return option;
  }));
  at("select").hidden = !may("select_part") || parts.length < 2;
}

function showRegion(name, mayDraw) {
  const item = element("li", name);
  if (mayDraw) {
    const button = element("button", t("Remove"));
    button.setAttribute("aria-label", t("Remove the region {name}", { name }));
    button.onclick = () => change(button, "set_regions", { remove: name }, saidOfRegions);
    item.append(button);
  }
  return item;
}

// Numbers between a few words, such as "ignored: 18.6 mm2 of 72 mm2 contact; 1 ignore".
const ofRegions = (said) => translations[said] || said.replace(/[a-z]+/g, (one) => t(one));
const saidOfRegions = (data) => t("Revision {revision}: {said}. It inspects when it is open; the one before stays as {kept}.", { ...data, said: ofRegions(data.said) });

// The press is the left panel of its sheet, below a head; to its right are a gap and as large a panel, then the legend.
const HEAD_PX = 40, GAP_AND_LEGEND_PX = 120;
let drawing = null; // { press, wide, high, mm, corners } while a region is drawn; mm: of a pixel of the sheet

function startDrawing() {
  const press = shown.presses.find((one) => one.has_picture), picture = new Image(), [wide_mm, high_mm] = shown.info.field_mm;
  at("draw-form").reset();
  drawing = null;
  at("sheet").replaceChildren();
  put("draw-press", [t(word(press)), named(press), clock(press)].filter(Boolean).join(" · "));
  picture.onload = () => {
    const wide = (picture.naturalWidth - GAP_AND_LEGEND_PX) / 2, high = wide * high_mm / wide_mm;
    drawing = { press: press.press_id, wide, high, mm: wide_mm / wide, corners: [] };
    at("sheet").setAttribute("viewBox", `0 ${HEAD_PX} ${wide} ${high}`);
    showDrawing(picture);
  };
  picture.src = `pictures/${press.press_id}`;
  showCorners();
  at("draw").showModal();
}

function showDrawing(picture) {
  const about = { href: picture.src, width: picture.naturalWidth, height: picture.naturalHeight };
  const { wide: width, high: height } = drawing; // the picture's other panels and its head are cut off
  const panel = shape("svg", { y: HEAD_PX, width, height, viewBox: `0 ${HEAD_PX} ${width} ${height}` });
  panel.append(shape("image", about));
  at("sheet").replaceChildren(panel, shape("polygon", { points: "" }));
  showCorners();
}

function showCorners() {
  const corners = drawing ? drawing.corners : [];
  const outline = at("sheet").querySelector("polygon");
  if (outline) { outline.setAttribute("points", corners.map(([x, y]) => `${x},${y + HEAD_PX}`).join(" ")); }
  at("sheet").querySelectorAll("circle").forEach((dot) => dot.remove());
  at("sheet").append(...corners.map(([x, y]) => shape("circle", { cx: x, cy: y + HEAD_PX, r: 4 })));
  put("corners", drawing ? t("{n} corners; a tap or click on the press adds one", { n: corners.length }) : t("Its picture is on its way."));
  at("draw-undo").disabled = !corners.length;
  at("draw-sure").disabled = corners.length < 3;
}

at("draw-region").onclick = startDrawing;
at("draw-cancel").onclick = () => at("draw").close();
at("draw-undo").onclick = () => { drawing.corners.pop(); showCorners(); };
at("sheet").onpointerdown = (event) => {
  if (!drawing) { return; }
  event.preventDefault();
  const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(at("sheet").getScreenCTM().inverse());
  const within = (value, most) => Math.max(0, Math.min(most, value));
  drawing.corners.push([within(place.x, drawing.wide), within(place.y - HEAD_PX, drawing.high)]);
  showCorners();
};
// What is drawn stays until the station has taken it: a corner is put right, and not the whole drawn again.
at("draw-form").onsubmit = async (event) => {
  event.preventDefault();
  const name = at("region-name").value.trim().replace(/[\s,]+/g, "-"), points = drawing.corners.map((corner) => corner.map((px) => Number((px * drawing.mm).toFixed(3))));
  put("corners", t("asked…"));
  const wanted = { add: name, kind: at("region-kind").value, points_mm: points, press_id: drawing.press };
  if (await change(at("draw-sure"), "set_regions", wanted, saidOfRegions)) { at("draw").close(); } else { put("corners", at("said").textContent); }
};

function showStation(station) {
  const state = station.state || { state: "starting" }, info = station.info || {}, stats = station.stats || {};
  document.title = [station.place, "gelgate"].filter(Boolean).join(" · ");
  put("place", station.place);
  const alarms = Object.values(station.alarms), raised = alarms.length === 1 ? t("1 alarm") : t("{n} alarms", { n: alarms.length });
  put("state", (station.away ? `${t("last known:")} ` : "") + t(state.state) + (state.reason ? `: ${tell(state.reason)}` : "")
    + (alarms.length ? `, ${raised}` : ""));
  at("state").className = station.away ? "away" : state.state === "ready" && alarms.length ? "alarmed" : state.state;
  put("away", tell(station.away) || "");
  at("away").hidden = !station.away;
  const most = alarmsInRow();
  draw("alarms", [alarms, may("acknowledge_alarm"), most], () => showAlarms(alarms, most));
  showPart(info);
  showPiece(station.piece);
  showGel(station.gel);
  showQuestions(station.questions, station.pictures || []);
  at("new-gel").hidden = !may("replace_gel") || !station.gel;
  put("sensor", [info.sensor_product, info.sensor_serial && `${t("serial")} ${info.sensor_serial}`,
    typeof stats.delivered_fps === "number" && t("{n} frames a second", { n: stats.delivered_fps.toFixed(1) }),
    stats.reconnects > 0 && t("{reconnects} reconnects", stats)].filter(Boolean).join(", ") || t("not known yet"));
  const receivers = Object.entries(stats.receivers || {});
  draw("receivers", receivers, () => receivers.map(([name, said]) => element("li", `${name}: ${tell(said)}`)));
  at("manual").hidden = !station.has_manual;
  const why = tell(station.changes.why_not);
  put("why-not", why || (key ? t("Unlocked. It locks itself after five minutes.") : t("Locked. With the token you select the part, acknowledge alarms and record a new gel.")));
  at("unlock").hidden = Boolean(why) || key !== null;
  at("lock").hidden = key === null;
}

function showRow(press) {
  const row = document.createElement("tr"), time = element("td", clock(press)), part = element("td", "");
  part.append(press.part, ...(press.position ? ["/", document.createElement("wbr"), press.position] : []));
  if (press.has_picture) {
    const link = element("a", clock(press));
    link.href = `pictures/${press.press_id}`;
    link.target = "_blank";
    link.setAttribute("aria-label", t("Picture of the press at {time}", { time: clock(press) }));
    time.replaceChildren(link);
  }
  row.append(element("td", t(word(press)), word(press)), element("td", ratio(press)), part, time);
  if (may("confirm_press")) {
    const cell = element("td", ""), button = element("button", t("Say…"));
    button.setAttribute("aria-label", t("Say what the press at {time} was", { time: clock(press) }));
    button.onclick = () => askWhat(press, press.has_picture);
    cell.append(button);
    row.append(cell);
  }
  return row;
}

// The press is fixed when the dialog opens: a list that changes under the hand changes no answer.
function askWhat(press, hasPicture) {
  at("what-form").reset();
  put("what-press", [t(word(press)), ratio(press) && t("{ratio} × threshold", { ratio: ratio(press) }), named(press), clock(press)].filter(Boolean).join(" · "));
  const picture = at("what-picture"), gone = t("Its picture is not here any more.");
  picture.hidden = true; // until it is here: the browser goes on showing that of another press
  picture.onload = () => { picture.hidden = false; put("no-picture", ""); };
  picture.onerror = () => put("no-picture", gone);
  put("no-picture", hasPicture ? t("Its picture is on its way.") : gone);
  if (hasPicture) { picture.src = `pictures/${press.press_id}`; } else { picture.removeAttribute("src"); }
  at("what").dataset.press = press.press_id;
  at("what").showModal();
  at("what-cancel").focus();
}

function showQuestions(questions, pictures) {
  const asked = (questions || {}).presses || [], mayAnswer = may("confirm_press");
  at("questions").hidden = !asked.length;
  put("asked", !asked.length ? "" : mayAnswer ? t("{n} presses would teach most today: say what they were.", { n: asked.length })
    : t("{n} presses would teach most today; unlock to say what they were.", { n: asked.length }));
  draw("ask", [asked, pictures, mayAnswer], () => asked.map((press) => {
    const item = element("li", ""), button = element("button", `${clock(press)} ${named(press)}: ${t(press.verdict)}, ${ratio(press) ? t("{ratio} × threshold", { ratio: ratio(press) }) : t("for its colours")}`);
    button.disabled = !mayAnswer;
    button.onclick = () => askWhat(press, pictures.includes(press.press_id));
    item.append(button);
    return item;
  }));
}

const shape = (tag, about) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  Object.entries(about).forEach(([name, value]) => made.setAttribute(name, value));
  return made;
};

// Two sums of one chart, upward what lies above and downward what lies below, between their limits.
function sketch(chart, limit) {
  const wide = 200, high = 44, middle = high / 2, top = 1.25 * limit, drawn = Math.max(chart.above.length, 2);
  const y = (value) => (middle - middle * Math.max(-top, Math.min(top, value)) / top).toFixed(1);
  const line = (sums, way) => shape("polyline", { class: chart.shift === way ? "out" : "sum",
    points: sums.map((sum, n) => `${(n * wide / (drawn - 1)).toFixed(1)},${y(way * sum)}`).join(" ") });
  const level = (value, name) => shape("line", { class: name, x1: 0, x2: wide, y1: y(value), y2: y(value) });
  const made = shape("svg", { viewBox: `0 0 ${wide} ${high}`, preserveAspectRatio: "none", "aria-hidden": "true" });
  made.append(level(limit, "limit"), level(-limit, "limit"), level(0, "centre"), line(chart.above, 1), line(chart.below, -1));
  return made;
}

function showChart(chart, drift) {
  const item = element("li", "", chart.shift ? "shifted" : ""), unit = chart.unit ? ` ${t(chart.unit)}` : "";
  const value = (number) => Number(number.toPrecision(3)) + unit;
  const said = chart.count < drift.learnt ? t("{count} of {learnt} presses learnt", { ...drift, ...chart })
    : [t("{newest} lately, {mean} in the mean:", { newest: value(chart.newest), mean: value(chart.mean) }),
      !chart.shift ? t("no shift") : `${chart.shift > 0 ? t("higher than before") : t("lower than before")}; ${t(chart.what_to_do)}`].join(" ");
  item.append(element("span", `${t(chart.title)}: ${said}`), sketch(chart, drift.limit));
  return item;
}

function showDrift(drift, last) {
  const charts = (drift || {}).charts || [];
  at("drift").hidden = !charts.length;
  put("drift-of", charts.length ? t("{part} on gel {gel_id}. A line beyond its limit says that something has shifted.", { ...drift, part: named(drift) }) : "");
  draw("charts", charts, () => charts.map((chart) => showChart(chart, drift)));
  const gain = (last || {}).light_gain;
  put("followed", gain ? t("The light has changed since the fit, and is followed: the last press was made {times} times brighter in red, green, blue.", { times: gain.map((one) => one.toFixed(2)).join(", ") }) : "");
}

function showPresses(presses, piece, state) {
  const last = lastOf(presses), newest = presses.slice(0, 12);
  draw("presses", [newest.map((press) => [press.press_id, press.has_picture]), may("confirm_press")], () => newest.map(showRow));
  at("say-head").hidden = !may("confirm_press");
  const verdict = last ? large(last, piece) : t("no press yet");
  const said = verdict === "pass" && state !== "ready" ? state : verdict; // as lights: nothing is inspected now
  at("verdict").className = /^(pass|fail|error|unsure|rejected)$/.test(said) ? said : "none";
  put("verdict", t(said));
  at("verdict").style.setProperty("--letters", at("verdict").textContent.length);
  if (!last) {
    for (const id of ["facts", "why", "cause"]) { put(id, ""); }
    at("frame").hidden = true;
    return;
  }
  put("facts", [named(last), ratio(last) && t("{ratio} × threshold", { ratio: ratio(last) }), clock(last)].filter(Boolean).join(" · "));
  const [, code, why] = /^(?:([a-z_]+): )?(.*)$/s.exec(last.reason || last.error || (last.press_again || {}).reason || "");
  put("why", [[code && t(code), tell(why)].filter(Boolean).join(": "), last.cause && t("cause: {cause}", { cause: t(last.cause) }), last.is_at_rest === false && t("lifted before it rested"), last.blind_area_mm2 > 0 && t("{mm2} mm2 under a mark of the gel are not judged: wipe it", { mm2: last.blind_area_mm2.toPrecision(2) })].filter(Boolean).join(" · "));
  put("cause", tell(last.cause_text || ""));
  if (shownPress !== null && shownPress !== last.press_id) { // two passes in a row are two
    at("verdict").classList.add("fresh");
    setTimeout(() => at("verdict").classList.remove("fresh"), FRESH_MS);
  }
  shownPress = last.press_id;
  const picture = last.has_picture ? `pictures/${last.press_id}` : "";
  at("frame").hidden = !picture;
  at("frame").href = picture;
  at("picture").alt = `${t("the press, and its scores")}: ${t(word(last))}, ${at("facts").textContent}`;
  if (at("picture").getAttribute("src") !== picture) {
    if (picture) { at("picture").setAttribute("src", picture); } else { at("picture").removeAttribute("src"); }
  }
}

function show() {
  if (shown !== null) {
    showStation(shown);
    const { state } = shown.away ? { state: "lost" } : shown.state || { state: "starting" };
    showPresses(shown.presses, shown.piece, state);
    showHand(shown.contact, state === "ready");
    showDrift(shown.drift, lastOf(shown.presses));
  }
}

function say(sentence, kind) {
  put("said", sentence);
  at("said").className = kind;
}

function lock() {
  key = null;
  clearTimeout(lockTimer);
  show();
}

function keepUnlocked() {
  clearTimeout(lockTimer);
  lockTimer = setTimeout(() => { lock(); say(t("Locked after five minutes without a change."), ""); }, LOCK_AFTER_MS);
}

async function ask(verb, given, wanted) {
  // crypto.randomUUID is missing where a page is not from this machine and not encrypted.
  const transaction = Array.from(crypto.getRandomValues(new Uint32Array(4)), (part) => part.toString(16)).join("-");
  const answer = await fetch(`requests/${verb}`, {
    method: "POST",
    headers: { "Content-Type": "application/json", Authorization: `Bearer ${given.token}` },
    body: JSON.stringify({ transaction, arguments: wanted, ...(given.by ? { by: given.by } : {}) }),
  });
  const response = await answer.json();
  if (response.status !== "ok") {
    throw Object.assign(new Error(response.error), { isLocked: answer.status === 401 });
  }
  return response.data;
}

async function change(button, verb, wanted, done) {
  if (key === null) { say(t("Not done: this page has locked itself; unlock it and say it again."), "error"); return false; }
  button.disabled = true;
  say(t("asked…"), "");
  let isDone = false;
  try {
    const data = await ask(verb, key, wanted);
    keepUnlocked();
    say(done(data), "ok");
    isDone = true;
  } catch (error) {
    say(t("Not done: {why}", { why: tell(error.message) }), "error");
    if (error.isLocked) { lock(); }
  }
  button.disabled = false;
  return isDone;
}

at("unlock").onsubmit = async (event) => {
  event.preventDefault();
  const given = { token: at("token").value.trim(), by: at("by").value.trim() };
  try {
    await ask("unlock", given, {});
    key = given;
    at("token").value = "";
    keepUnlocked();
    say(t("Unlocked."), "ok");
  } catch (error) {
    say(t("Not unlocked: {why}", { why: tell(error.message) }), "error");
    at("token").select();
  }
  show();
};

at("lock").onclick = () => { lock(); say(t("Locked."), ""); };

at("select").onsubmit = (event) => {
  event.preventDefault();
  const name = at("parts").value;
  change(event.submitter || at("select").querySelector("button"), "select_part", { name },
    (data) => data.is_waiting ? t("{name} is inspected when this press has ended.", { name }) : t("{name} is inspected from now on.", { name }));
};

at("begin").onsubmit = (event) => {
  event.preventDefault();
  const piece_id = at("piece-id").value.trim();
  change(event.submitter || at("begin").querySelector("button"), "begin_piece", piece_id ? { piece_id } : {}, (data) => {
    at("piece-id").value = "";
    return t("The piece {piece_id} has begun. Press: {places}", { ...data, places: data.expected.join(` ${t("or")} `) });
  });
};

at("new-gel").onclick = () => { at("gel-form").reset(); at("confirm").showModal(); at("cancel").focus(); };
at("cancel").onclick = () => at("confirm").close();
at("gel-form").onsubmit = () => {
  const limit = at("limit").valueAsNumber, wanted = Number.isInteger(limit) ? { limit_presses: limit } : {};
  for (const [name, field] of [["gel_serial", "gel-serial"], ["gel_type", "gel-type"], ["use_by", "use-by"], ["note", "note"]]) {
    const said = at(field).value.trim();
    if (said) { wanted[name] = said; }
  }
  change(at("new-gel"), "replace_gel", wanted, (data) => [t("Gel {gel_id} counts from now on.", data),
    ...data.remarks.map(tell).map((said) => `${said[0].toUpperCase()}${said.slice(1)}.`), t("Leave it free until the station is ready.")].join(" "));
};

// Enter in the field would press the first button, "good".
at("kind").onkeydown = (event) => { if (event.key === "Enter") { event.preventDefault(); } };
at("what-cancel").onclick = () => at("what").close();
at("what-form").onsubmit = (event) => {
  const verdict = event.submitter.value, kind = at("kind").value.trim(), press_id = at("what").dataset.press;
  change(event.submitter, "confirm_press", { press_id, verdict, ...(kind && verdict === "damaged" ? { kind } : {}) },
    (data) => [t("Kept: {what}. The station had said: {verdict}.", { what: t(verdict.replace("_", " ")) + (kind && verdict === "damaged" ? `, ${kind}` : ""), verdict: t(data.verdict) }),
      data.earlier.length && t("Said before: {earlier}.", { earlier: data.earlier.join(", ") }),
      !data.is_archived && t("It is not archived, so nothing can be learnt from it."),
      ...(data.remarks || []).map(tell).map((said) => `${said[0].toUpperCase()}${said.slice(1)}.`)].filter(Boolean).join(" "));
};

// A cable that is pulled ends no request: without a limit the last verdict would stay as if it were of now.
async function look() {
  const limit = new AbortController(), silence = setTimeout(() => limit.abort(), SILENT_MS);
  try {
    const answer = await fetch(shown === null ? "live.json" : `live.json?after=${shown.version}`, { signal: limit.signal });
    if (!answer.ok) { throw new Error(await answer.text()); }
    shown = await answer.json();
    document.body.className = shown.away || ["lost", "stopped"].includes((shown.state || {}).state) ? "gone" : "";
    show();
    setTimeout(look, 0);
  } catch {
    setTimeout(look, AGAIN_MS);
    document.body.className = "gone";
    shown = shown && { ...shown, version: -1, state: { state: "lost" } };
    show();
    put("state", t("the gateway does not answer"));
    at("state").className = "lost";
  } finally {
    clearTimeout(silence);
  }
}

// The texts of the page's HTML, which is English, and where each stands.
const TEXTS = [];
const WALK = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT,
  (node) => node.data.trim() && !node.parentElement.closest("[translate=no], noscript, script") ? NodeFilter.FILTER_ACCEPT : NodeFilter.FILTER_REJECT);
while (WALK.nextNode()) { const node = WALK.currentNode, text = node.data.trim(); TEXTS.push(() => { node.data = t(text); }); }
for (const name of ["aria-label", "alt"]) {
  document.querySelectorAll(`[${name}]`).forEach((one) => {
    const text = one.getAttribute(name);
    if (text) { TEXTS.push(() => one.setAttribute(name, t(text))); }
  });
}

async function speak(language) {
  const { sentences, ...texts } = language === "en" ? {} : await (await fetch(`words/${language}.json`)).json();
  translations = Object.assign(Object.create(null), texts, sentences); // a part may be named "constructor"
  patterns = Object.keys(sentences || {}).sort((one, other) => other.length - one.length).map((text) => [text, text.split(/\{(\w+)\}/)]);
  document.documentElement.lang = at("language").value = language;
  TEXTS.forEach((write) => write());
  drawn.clear();
  show();
}

at("language").onchange = () => { localStorage.setItem("language", at("language").value); speak(at("language").value); };
const known = Array.from(at("language").options, (option) => option.value);
const wanted = [localStorage.getItem("language"), ...navigator.languages.map((one) => one.slice(0, 2))].find((one) => known.includes(one));
speak(wanted || "en").finally(look);
