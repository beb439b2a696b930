"use strict";
// Everything is set as text, never as HTML: a part's name is what a person has typed.
const EVERY_MS = 1000;
const at = (id) => document.getElementById(id);
const word = (press) => press.verdict || "error";
const put = (id, text) => { if (at(id).textContent !== text) { at(id).textContent = text; } };

function element(tag, text, name) {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = name || "";
  return made;
}

const clock = (press) => new Date(press.time_ms).toLocaleTimeString("en-GB");

function ratio(press, unit) {
  return typeof press.score_ratio === "number" ? `${press.score_ratio.toFixed(2)} ×${unit}` : "";
}

function showStation(station) {
  const state = station.state || { state: "starting" }, gel = station.gel, stats = station.stats || {};
  put("place", station.place);
  put("state", state.state + (state.reason ? ": " + state.reason : ""));
  at("state").className = state.state;
  const alarms = Object.values(station.alarms).map((one) => element("p", one.text, one.severity));
  at("alarms").replaceChildren(...alarms);
  if (gel) {
    put("gel", `${gel.presses} of ${gel.limit_presses} presses, ${Math.max(0, gel.limit_presses - gel.presses)} left: ${gel.state}`);
    at("worn").style.width = Math.min(100, 100 * gel.presses / gel.limit_presses) + "%";
    at("worn").className = gel.state;
  }
  const receivers = Object.entries(stats.receivers || {}).map(([name, said]) => element("li", `${name}: ${said}`));
  at("receivers").replaceChildren(...receivers);
}

function showPresses(presses) {
  const last = presses[0];
  at("verdict").className = last ? word(last) : "none";
  if (!last) { return; }
  put("verdict", word(last));
  put("facts", [last.part, last.position, ratio(last, " threshold"), clock(last)].filter(Boolean).join(" · "));
  put("why", last.reason || last.error || "");
  const picture = last.has_picture ? `pictures/${last.press_id}.png` : "";
  if (at("picture").getAttribute("src") !== picture) { at("picture").setAttribute("src", picture); }
  at("picture").hidden = !picture;
  at("presses").replaceChildren(...presses.slice(0, 12).map((press) => {
    const row = document.createElement("tr");
    row.append(
      element("td", word(press), word(press)),
      element("td", ratio(press, "")),
      element("td", [press.part, press.position].filter(Boolean).join("/")),
      element("td", clock(press)));
    return row;
  }));
}

async function look() {
  try {
    const [station, presses] = await Promise.all(
      ["station.json", "presses.json"].map((name) => fetch(name).then((answer) => answer.json())));
    showStation(station);
    showPresses(presses);
    document.body.className = "";
  } catch (error) {
    put("state", "the gateway does not answer");
    at("state").className = "lost";
    document.body.className = "gone";
  }
  setTimeout(look, EVERY_MS);
}

look();
