// The page: what comes from the run is shown, what people want goes back.

import { StreetMap } from "./map.js";
import { dial, reward, TERMS } from "./plots.js";
import { Hands } from "./drive.js";

const $ = (id) => document.getElementById(id);
const query = location.search;
const kept = (key, value) => { try { return value === undefined ? localStorage.getItem("wad-" + key) : localStorage.setItem("wad-" + key, value); } catch { return null; } };

// For people who look behind the page, and for its tests.
const wad = (window.wad = { frames: 0, latencies: [], state: null, hello: null, route: 0 });

let socket = null, hello = null, state = null, points = [], noted = 0, counts = {}, look = kept("look") || "front", wait = 400;

// ---- theme ----
const dark = matchMedia("(prefers-color-scheme: dark)");
function setTheme(theme) {
  if (theme) document.documentElement.dataset.theme = theme;
  map?.recolour();
  paint();
}
function otherTheme() {
  const now = document.documentElement.dataset.theme || (dark.matches ? "dark" : "light");
  const next = now === "dark" ? "light" : "dark";
  kept("theme", next);
  setTheme(next);
}
let map = null;
if (kept("theme")) document.documentElement.dataset.theme = kept("theme");
dark.addEventListener("change", () => setTheme());

map = new StreetMap($("map"), $("map-scale"), (m) => {
  $("map-follow").setAttribute("aria-pressed", m.follow);
  $("map-turn").setAttribute("aria-pressed", m.turn);
}, (ego) => follow(ego));
const send = (message) => { if (socket?.readyState === 1) socket.send(typeof message === "string" ? message : JSON.stringify(message)); };
wad.send = send;
const hands = new Hands(send, $("pads"));

// ---- connection ----
function connect() {
  setLink("wait", "connecting");
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws${query}`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (event) => {
    heard = performance.now();
    typeof event.data === "string" ? tell(JSON.parse(event.data)) : show(event.data);
  };
  socket.onopen = () => (wait = 400);
  socket.onclose = (event) => {
    hands.stop();
    document.body.classList.remove("driving");
    $("pads").hidden = true;
    setLink("off", event.reason || "no connection");
    banner(event.reason || "connection lost, trying again");
    setTimeout(connect, wait);
    wait = Math.min(wait * 1.6, 4000);
  };
}

function setLink(kind, text) {
  $("link").className = "link " + kind;
  if ($("link").textContent !== text) $("link").textContent = text;
}

// When the server last said anything, and when the state that is shown came (ms).
let heard = 0, shown = 0;
/// Seconds for which the server has said nothing, once that is too long; else 0.
const silence = () => { const s = (performance.now() - heard) / 1000; return s > 1.5 ? s : 0; };
/// The link's label: what is shown is live only as long as ticks come.
function link() {
  if (!state || socket?.readyState !== 1) return;
  const age = (performance.now() - shown) / 1000, due = Math.max(1.5, state.speed_factor > 0 ? (3 * state.dt) / state.speed_factor : 0);
  if (silence()) setLink("wait", `no answer for ${silence().toFixed(0)} s`);
  else if (hello.mode === "replay") setLink("on", "replay");
  else if (state.paused || state.over) setLink("on", state.paused ? "paused" : "live");
  else if (age > due) setLink("wait", `${age.toFixed(0)} s old`);
  else setLink("on", "live");
}
setInterval(() => { link(); if (state && silence()) says(state); }, 250);

function banner(text) {
  const old = $("banner").textContent;
  if (old === text) return;
  $("banner").replaceChildren();
  if (text) { const span = document.createElement("span"); span.textContent = text; $("banner").append(span); }
}

function tell(message) {
  if (message.type === "hello") greet(message);
  else if (message.type === "route") { wad.route = message.id; map.setRoute(message.line); }
  else if (message.type === "refused") note({ time: state?.time || 0, said: "refused: " + message.why }, "warn");
  else if (message.type === "beat") { if (state && hello?.mode === "run" && state.holder !== message.holder) { state.holder = message.holder; paint(); } }
}

async function greet(message) {
  const again = hello && hello.town === message.town && hello.folder === message.folder;
  hello = wad.hello = message;
  points = message.history;
  noted = 0;
  counts = {};
  noEvents();
  $("town").textContent = message.town;
  document.title = `${message.town} · wad-cosim`;
  document.body.classList.toggle("replay", message.mode === "replay");
  for (const e of document.querySelectorAll(".run-only")) e.hidden = message.mode === "replay";
  for (const e of document.querySelectorAll(".replay-only")) e.hidden = message.mode !== "replay";
  for (const e of document.querySelectorAll(".stages-only")) e.hidden = !message.stages;
  for (const e of document.querySelectorAll(".reconstruction-only")) e.hidden = !message.reconstruction;
  options($("weather"), message.weathers.map((name) => [name, words(name)]));
  if (!again) drivers();
  setLink("on", "live");
  banner("");
  if (message.mode === "replay") replay(message);
  setLook(look);
  if (!again) {
    map.trail = [];
    map.setNet(await (await fetch("map.json" + query)).json());
  }
}

const driverName = (name) => name.startsWith("wad-") ? name.slice(0, 5).toUpperCase() + name.slice(5).replaceAll("-", " ") : name.split("/").pop();
const words = (name) => name.replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase().replace(/^./, (c) => c.toUpperCase());
function options(select, list) {
  select.replaceChildren(...list.map(([value, text]) => Object.assign(document.createElement("option"), { value, textContent: text })));
}

/// Where there are several egos: which of them is followed.
function egos(s) {
  const count = s.egos?.length || 0, select = $("egos");
  $("egos-label").hidden = count < 2;
  if (select.options.length !== count) options(select, Array.from({ length: count }, (_, i) => [String(i), `ego ${i + 1} of ${count}`]));
  if (document.activeElement !== select) select.value = String(s.followed);
}
const follow = (ego) => send({ do: "follow", ego });

function drivers() {
  const names = ["autopilot", ...hello.agents, "manual"];
  $("drivers").replaceChildren(...names.map((name) => {
    const b = Object.assign(document.createElement("button"), { type: "button", textContent: driverName(name) });
    b.setAttribute("role", "radio");
    b.setAttribute("aria-checked", "false");
    b.dataset.name = name;
    if (name === "manual") b.title = "Take the wheel (M)";
    b.onclick = () => pick(name);
    return b;
  }));
}

let drove = "autopilot";
/// Take the wheel, or give it back to who drove before.
function takeOrLeave() {
  // A beat tells who holds the wheel before a tick tells who drove.
  if (state && state.driver !== "manual") drove = state.driver;
  const before = state?.before || drove, back = hello?.agents.includes(before) ? before : "autopilot";
  pick(state?.holder === hello?.you ? back : "manual");
}
for (const id of ["take", "leave"]) $(id).onclick = takeOrLeave;

// Radio buttons by the arrow keys; one of each group is reached by Tab.
for (const group of document.querySelectorAll("[role=radiogroup]")) {
  group.addEventListener("keydown", (e) => {
    const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[e.key];
    const all = [...group.children].filter((b) => !b.disabled), at = all.indexOf(e.target);
    if (!by || at < 0 || hands.driving) return;
    e.preventDefault();
    const next = all[(at + by + all.length) % all.length];
    next.focus();
    next.click();
  });
}
function tabStops() {
  for (const group of document.querySelectorAll("[role=radiogroup]")) {
    const all = [...group.children], chosen = all.find((b) => b.getAttribute("aria-checked") === "true") || all[0];
    for (const b of all) { const stop = b === chosen ? 0 : -1; if (b.tabIndex !== stop) b.tabIndex = stop; }
  }
}

function pick(name) {
  send({ do: "driver", name });
  if (name === "manual") $("screen").focus({ preventScroll: true });
}

// ---- a tick ----
async function show(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const next = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let at = 4 + size;
  const pictures = [];
  for (const [name, length] of next.images) {
    pictures.push([name, new Blob([new Uint8Array(buffer, at, length)], { type: "image/jpeg" })]);
    at += length;
  }
  const drawn = await Promise.all(pictures.map(async ([name, blob]) => [name, await createImageBitmap(blob)]));
  if (!state || next.tick !== state.tick) remember(next);
  state = wad.state = next;
  shown = performance.now();
  map.update(next);
  paintPictures(drawn);
  paint();
  tellNotes(next.notes);
  requestAnimationFrame(() => {
    send({ do: "shown", seq: next.seq });
    wad.frames++;
    const late = performance.timeOrigin + performance.now() - next.at;
    wad.latencies.push(late);
    if (wad.latencies.length > 200) wad.latencies.shift();
  });
}

function remember(next) {
  const last = points.length ? points[points.length - 1][0] : -1;
  // Put down elsewhere: another course begins.
  const far = state && Math.hypot(next.ego.x - state.ego.x, next.ego.y - state.ego.y) > 25;
  if ((far || next.time < last - 1e-3) && hello.mode !== "replay") points = [];
  if (next.time > last && hello.mode !== "replay") points.push([next.time, next.ego.speed, next.limit, ...next.reward]);
  if (points.length > 900 && hello.mode !== "replay") points.shift();
}

const cameraContext = $("camera").getContext("2d");
function paintPictures(drawn) {
  for (const [name, bitmap] of drawn) {
    if (name === look || (name === "front" && !drawn.some(([other]) => other === look))) {
      const canvas = $("camera");
      if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
      cameraContext.drawImage(bitmap, 0, 0);
      if (name === "front" && state.sees && $("boxes").checked) overlay();
    } else if (name === "mirror" && look === "front") {
      const side = 170, x = state.mirror === "left" ? 2 : 510 - side, y = 510 - side;
      cameraContext.drawImage(bitmap, x, y, side, side);
      cameraContext.strokeStyle = "#ebebeb";
      cameraContext.lineWidth = 2;
      cameraContext.strokeRect(x - 1, y - 1, side + 2, side + 2);
    } else if (name === "transformed" || name === "reconstruction") {
      $(name).getContext("2d").drawImage(bitmap, 0, 0, 128, 128);
    }
    bitmap.close();
  }
}

function overlay() {
  const c = cameraContext, { boxes, lanes, light: lamp, red, signs, road } = state.sees;
  c.fillStyle = "#963cdc33";
  for (const [l, t, r, b] of road) c.fillRect(l, t, r - l, b - t);
  c.lineWidth = 2;
  c.font = "12px system-ui, DejaVu Sans, sans-serif";
  for (const [name, l, t, r, b, sure] of boxes) {
    c.strokeStyle = name === "Person" ? "#ff5aa0" : name === "TrafficLight" ? "#ffe14a" : "#5ab4ff";
    c.strokeRect(l + 1, t + 1, r - l - 2, b - t - 2);
    if (r - l > 26) { c.fillStyle = c.strokeStyle; c.fillText(`${words(name).toLowerCase()} ${sure} %`, l + 2, Math.max(t - 4, 11)); }
  }
  c.fillStyle = "#fff";
  for (const [says, x, y, sure] of signs) c.fillText(`${says} (${sure} %)`, x + 8, Math.max(y - 8, 11));
  c.strokeStyle = "#43e07d";
  c.lineWidth = 3;
  for (const lane of lanes) {
    c.beginPath();
    for (let i = 0; i + 1 < lane.length; i += 2) i ? c.lineTo(lane[i], lane[i + 1]) : c.moveTo(lane[i], lane[i + 1]);
    c.stroke();
  }
  if (lamp) {
    c.font = "15px system-ui, DejaVu Sans, sans-serif";
    const text = seenLight(lamp);
    c.fillStyle = "#000a";
    c.fillRect(8, 8, c.measureText(text).width + 12, 23);
    c.fillStyle = { bad: "#ff5a4f", warn: "#ffe14a", good: "#43e07d" }[lightColour[lamp.state]] || "#fff";
    c.fillText(text, 14, 25);
  }
  if (red) { c.strokeStyle = "#ff2d20"; c.lineWidth = 6; c.strokeRect(3, 3, 506, 506); }
}

const seenLight = lamp => lamp ? `${light[lamp.state] || lamp.state}, ${lamp.distance.toFixed(0)} m` : "none";

// ---- gauges ----
const put = (id, text) => { const e = $(id); if (e.textContent !== text) e.textContent = text; };
const option = { LaneFollow: "follow lane", Left: "← left", Right: "right →", Straight: "↑ straight on", ChangeLaneLeft: "↖ change lane", ChangeLaneRight: "↗ change lane" };
const light = { red: "red", red_yellow: "red and yellow", yellow: "yellow", green_minor: "green, give way", green_major: "green", stop_then_go: "stop, then go", off: "off" };
const lightColour = { red: "bad", red_yellow: "bad", yellow: "warn", green_minor: "good", green_major: "good", stop_then_go: "bad" };

function clock(s) {
  const tenths = Math.round(s * 10), m = Math.floor(tenths / 600);
  return `${m}:${((tenths - 600 * m) / 10).toFixed(1).padStart(4, "0")}`;
}

/// The banner: who drives, as far as the server says so.
function says(s) {
  const quiet = hello.mode === "replay" ? "" : "no answer: the autopilot takes the wheel of who is not heard";
  const drives = s.holder === null ? "" : silence() ? quiet : s.holder === hello.you ? (matchMedia("(pointer: coarse)").matches ? "you drive" : "you drive: arrow keys, M gives back") : `viewer ${s.holder} drives`;
  banner(s.over ? s.over : s.loading ? `loading ${s.loading.toUpperCase()}` : s.paused ? (hello.mode === "replay" ? "" : "paused") : drives);
}

function paint() {
  if (!state) return;
  const s = state;
  put("time", clock(s.time));
  put("pace", s.paused ? "paused" : s.pace.toFixed(1) + "×");
  put("traffic-now", `${s.traffic[0]} + ${s.traffic[1]}`);
  put("viewers", String(s.viewers));
  const late = [...wad.latencies.slice(-15)].sort((a, b) => a - b)[Math.min(7, wad.latencies.length >> 1)];
  put("latency", late >= 0 && late < 9999 && hello.mode === "run" ? late.toFixed(0) + " ms" : "–");
  link();
  $("pause").setAttribute("aria-pressed", s.paused);
  put("pause", s.paused ? (s.over && hello.mode === "replay" ? "Play again" : "Go on") : "Pause");
  if (document.activeElement !== $("speed")) $("speed").value = String(s.speed_factor);
  if (document.activeElement !== $("weather")) $("weather").value = s.weather;
  traffic(s.wanted_traffic);
  egos(s);
  for (const b of $("drivers").children) {
    const mine = b.dataset.name;
    b.setAttribute("aria-checked", mine === s.driver);
    b.setAttribute("aria-busy", mine === s.loading);
    b.disabled = s.holder !== null && s.holder !== hello.you;
  }
  tabStops();
  const mine = s.holder !== null && s.holder === hello.you;
  document.body.classList.toggle("driving", mine);
  mine ? hands.start() : hands.driving && hands.stop();
  const touch = matchMedia("(pointer: coarse)").matches;
  $("pads").hidden = !(mine && touch);
  $("take").hidden = mine || s.holder !== null || hello.mode === "replay" || !touch;
  says(s);
  $("record").setAttribute("aria-pressed", s.recording !== null);
  put("record", s.recording !== null ? "■ Stop" : "● Record");
  dial($("dial"), s.ego.speed, s.limit);
  put("light", s.light ? `${light[s.light.state]}, ${s.light.distance.toFixed(0)} m` : "–");
  $("light").style.color = s.light && lightColour[s.light.state] ? `var(--${lightColour[s.light.state]})` : "";
  put("gap", s.leader ? `${s.leader.gap.toFixed(0)} m, ${(s.leader.speed * 3.6).toFixed(0)} km/h` : "–");
  put("option", option[s.option] || "–");
  put("togo", s.route[2] > 0 ? `${Math.max(0, s.route[2] - s.route[0]).toFixed(0)} of ${s.route[2].toFixed(0)} m` : "–");
  put("reason", s.reason || (mine ? "you drive" : s.driver.startsWith("wad") ? "learned" : "–"));
  bar("steer", -s.control.steer, true);
  bar("throttle", s.control.throttle);
  bar("brake", s.control.brake);
  put("gear", s.control.reverse ? "reverse" : "throttle");
  const total = s.reward.reduce((a, b) => a + b, 0);
  put("reward-now", (total >= 0 ? "+" : "−") + Math.abs(total).toFixed(2));
  reward($("reward"), shownPoints(), s.sums);
  if (s.sees) {
    put("sees-objects", String(s.sees.boxes.length));
    put("sees-lanes", ["none", "one", "both"][s.sees.lanes.length]);
    put("sees-gap", s.sees.gap === null ? "–" : s.sees.gap.toFixed(0) + " m");
    put("sees-light", seenLight(s.sees.light));
    put("sees-limit", s.sees.limit === null ? "–" : s.sees.limit + " km/h");
  }
  if (hello.mode === "replay") {
    if (!scrubbing) $("scrub").value = s.tick;
    if (!marked) marks();
    put("scrub-now", `${s.tick} / ${hello.ticks - 1} · ${clock(s.time)}`);
  }
}

const shownPoints = () => (hello.mode === "replay" ? points.filter((p) => p[0] <= state.time + 1e-3) : points);

function bar(name, value, both) {
  const i = $(name).firstElementChild;
  if (both) {
    i.style.left = `${50 + Math.min(0, value) * 50}%`;
    i.style.width = `${Math.abs(value) * 50}%`;
  } else i.style.width = `${value * 100}%`;
  $(name + "-meter").value = both ? -value : value;
  put(name + "-now", both ? (Math.abs(value) < 0.005 ? "0" : (value < 0 ? "◀ " : "▶ ") + Math.abs(value * 100).toFixed(0)) : (value * 100).toFixed(0) + " %");
}

function traffic(wanted) {
  const select = $("traffic");
  if (document.activeElement === select) return;
  const value = wanted ? wanted.join(",") : "";
  if (![...select.options].some((o) => o.value === value)) select.add(new Option(`${wanted[0]} cars, ${wanted[1]} people`, value));
  select.value = value;
}

// What people who do not see the canvases are told, now and then.
setInterval(() => {
  if (!state) return;
  const s = state;
  $("dial").setAttribute("aria-label", `Speed ${(s.ego.speed * 3.6).toFixed(0)} of ${(s.limit * 3.6).toFixed(0)} kilometres an hour`);
  $("camera").setAttribute("aria-label", `Camera, ${look === "front" ? "through the windscreen" : "from behind"}, ${words(s.weather)}${s.sees ? `, ${s.sees.boxes.length} objects found` : ""}`);
  $("reward").setAttribute("aria-label", "Sums of the reward: " + TERMS.map((name, i) => `${name} ${s.sums[i].toFixed(1)}`).join(", "));
}, 2000);

// ---- events ----
const EVENTS = {
  collision: (e) => ["bad", `collision with ${e.kind} ${e.partner}, ${e.impulse.toFixed(0)} N s; caused by ${String(e.cause).replace(/_/g, " ")}`],
  red_light: (e) => ["bad", `ran the red light ${e.traffic_light} at ${(e.speed * 3.6).toFixed(0)} km/h`],
  outside_lane: (e) => ["warn", `left its lane by ${e.offset.toFixed(1)} m`],
  sidewalk: () => ["warn", "a wheel left the road"],
  vehicle_blocked: () => ["warn", "blocked: stood too long without a reason"],
  arrival: () => ["good", "arrived"],
};
// A replay that is dragged back has fewer of them.
function tellNotes(notes) {
  const last = notes.length ? notes[notes.length - 1].n : 0;
  if (last < noted && hello.mode === "replay") { noted = 0; counts = {}; noEvents(); }
  for (const n of notes) if (n.n > noted) { noted = n.n; note(n); }
}
function noEvents() {
  $("events").replaceChildren(Object.assign(document.createElement("li"), { className: "none", textContent: "nothing yet" }));
  put("counts", "");
}
function note(n, forced) {
  let [kind, text] = n.event ? (EVENTS[n.event] || (() => ["", n.event]))(n) : [forced || "", n.said];
  if (n.event) counts[n.event] = (counts[n.event] || 0) + 1;
  const li = document.createElement("li");
  li.className = kind;
  const time = document.createElement("time");
  time.textContent = clock(n.time);
  li.append(time, text);
  const list = $("events");
  list.querySelector(".none")?.remove();
  list.prepend(li);
  while (list.children.length > 120) list.lastElementChild.remove();
  const wrong = ["collision", "red_light", "outside_lane", "sidewalk", "vehicle_blocked"].reduce((a, k) => a + (counts[k] || 0), 0);
  put("counts", `${wrong} infraction${wrong === 1 ? "" : "s"}, ${counts.arrival || 0} arrival${counts.arrival === 1 ? "" : "s"}`);
}

// ---- replay ----
let scrubbing = false, marked = false;
function replay(message) {
  $("scrub").max = Math.max(0, message.ticks - 1);
  points = message.course || [];
  map.trail = [];
  const list = message.episodes || [], outcomes = [...new Set(list.map((e) => e.outcome))].sort();
  const chosen = $("outcome").value;
  options($("outcome"), [["", `all (${list.length})`], ...outcomes.map((o) => [o, `${o.replace(/_/g, " ")} (${list.filter((e) => e.outcome === o).length})`])]);
  $("outcome").value = outcomes.includes(chosen) ? chosen : "";
  episodes();
  marked = false;
}
function marks() {
  marked = true;
  const canvas = $("marks"), bar = $("scrub").getBoundingClientRect(), all = $("timeline").getBoundingClientRect();
  canvas.width = Math.max(1, Math.round(all.width));
  const c = canvas.getContext("2d");
  for (const [tick, kind] of hello.marks || []) {
    c.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(kind === "arrival" ? "--good" : "--bad");
    c.fillRect(bar.left - all.left + 8 + ((bar.width - 16) * tick) / Math.max(1, hello.ticks - 1) - 1.5, 0, 3, 8);
  }
}
function episodes() {
  const wanted = $("outcome").value;
  $("episodes").replaceChildren(...(hello.episodes || []).filter((e) => !wanted || e.outcome === wanted).map((e) => {
    const li = document.createElement("li"), b = document.createElement("button"), small = document.createElement("small");
    b.type = "button";
    b.textContent = e.name;
    small.textContent = e.about;
    b.append(small);
    if (e.id === hello.episode) b.setAttribute("aria-current", "true");
    b.onclick = () => send({ do: "open", episode: e.id });
    li.append(b);
    return li;
  }));
}
$("outcome").onchange = episodes;
$("scrub").oninput = () => { scrubbing = true; send({ do: "seek", tick: Number($("scrub").value) }); };
$("scrub").onchange = () => (scrubbing = false);

// ---- controls ----
function setLook(next) {
  look = next;
  kept("look", next);
  for (const b of $("looks").children) b.setAttribute("aria-checked", b.dataset.look === next);
  document.body.classList.toggle("wide", next === "chase");
  send({ do: "look", chase: next === "chase", stages: Boolean(hello?.stages) });
}
const pause = () => send({ do: "pause", on: !state?.paused });
const step = () => send({ do: "step" });
$("pause").onclick = pause;
$("step").onclick = step;
$("speed").onchange = () => send({ do: "speed", factor: Number($("speed").value) });
$("weather").onchange = () => send({ do: "weather", name: $("weather").value });
$("traffic").onchange = () => { const [vehicles, pedestrians] = $("traffic").value.split(",").map(Number); send({ do: "traffic", vehicles, pedestrians }); };
$("egos").onchange = () => { follow(Number($("egos").value)); $("egos").blur(); };
$("respawn").onclick = () => send({ do: "respawn" });
$("new-route").onclick = () => send({ do: "new_route" });
$("record").onclick = () => send({ do: "record", on: state?.recording === null });
for (const b of $("looks").children) b.onclick = () => setLook(b.dataset.look);
$("map-in").onclick = () => map.zoomBy(1.35);
$("map-out").onclick = () => map.zoomBy(1 / 1.35);
$("map-all").onclick = () => map.showAll();
$("map-follow").onclick = () => map.setFollow(!map.follow);
$("map-turn").onclick = () => map.setTurn(!map.turn);
$("theme").onclick = otherTheme;
$("help-button").onclick = () => $("help").showModal();

const SHORT = {
  p: pause, ".": step, t: otherTheme, "?": () => $("help").showModal(),
  m: takeOrLeave,
  r: () => $("respawn").click(), n: () => $("new-route").click(),
  e: () => { if (state?.egos) follow((state.followed + 1) % state.egos.length); },
  c: () => setLook(look === "front" ? "chase" : "front"), b: () => $("boxes").click(),
  "+": () => map.zoomBy(1.35), "=": () => map.zoomBy(1.35), "-": () => map.zoomBy(1 / 1.35), 0: () => map.showAll(),
  f: () => map.setFollow(!map.follow), u: () => map.setTurn(!map.turn),
};
addEventListener("keydown", (e) => {
  if (e.ctrlKey || e.metaKey || e.altKey || e.target.closest?.("input[type=text], select, dialog")) return;
  const does = SHORT[e.key] || SHORT[e.key.toLowerCase()];
  if (does) { e.preventDefault(); does(); }
});
// Somebody who looks elsewhere does not drive.
document.addEventListener("visibilitychange", () => { if (document.hidden && hands.driving) send({ do: "driver", name: "autopilot" }); });
addEventListener("resize", () => { paint(); marked = false; });

let drawnAt = 0;
function frame(now) {
  if (now - drawnAt > 30) { drawnAt = now; map.draw(); }
  requestAnimationFrame(frame);
}
requestAnimationFrame(frame);
connect();
