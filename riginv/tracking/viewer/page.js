"use strict";
// The page of an inversion: meshes by WebGL2 (scene.js), everything else here. Nothing is fetched.
(async () => {
const $ = (id) => document.getElementById(id);
const facts = JSON.parse($("facts").textContent);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const PALETTE = ["#e3a857", "#5fb4c9", "#b58adf", "#7fc47f", "#e07a6a", "#d8cf6a", "#6f8fe0", "#d983b5"];

async function unpack(id) { // gzip in base64
  const text = atob($(id).textContent), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function whole(bytes, width) { // low bytes, then high bytes, of each row's change from the row before
  const count = bytes.length / 2, found = new Int16Array(count);
  for (let i = 0; i < count; i++) found[i] = (bytes[i] | (bytes[count + i] << 8)) + (i < width ? 0 : found[i - width]);
  return found;
}

const { numbers, shown, controls, errors, vertices } = facts;
const frames = numbers.length, width = vertices * 3;
let meshes, values, scene;
try {
  meshes = whole(await unpack("meshes"), 2 * width);
  values = whole(await unpack("values"), controls.length);
  const colors = facts.colored ? await unpack("colors") : null;
  const faces = new Uint32Array((await unpack("faces")).buffer);
  scene = makeScene($("view"), faces, colors, facts, facts.scans.length ? await unpack("scans") : null);
} catch (error) {
  $("badge").textContent = `This page needs a browser with WebGL 2: ${error.message}`;
  return;
}
// A control's value lies in [0, 1] of its range.
const share = (row, control) => (values[row * controls.length + control] + 32767) / 65534;
const valueAt = (row, control) => controls[control].lower + share(row, control) * (controls[control].upper - controls[control].lower);
const flagged = errors.flags.map((flags, row) => (flags.length ? row : -1)).filter((row) => row >= 0);
const order = controls.map((_, i) => i).map((i) => [i, activity(i)]).sort((a, b) => b[1] - a[1]).map(([i]) => i);
const state = { row: 0, playing: false, heat: false, wires: false, show: "both", chosen: order.slice(0, 4), top: facts.top_mm };

function activity(control) { // how far a curve travels, as a share of its range
  let low = 1, high = 0;
  for (let row = 0; row < frames; row++) { const s = share(row, control); low = Math.min(low, s); high = Math.max(high, s); }
  return high - low;
}

// The mesh of a row lies between the two that are kept on either side of it.
function pose(row) {
  let low = 0, high = shown.length - 1;
  while (low < high) { const middle = (low + high + 1) >> 1; if (shown[middle] <= row) low = middle; else high = middle - 1; }
  const next = Math.min(low + 1, shown.length - 1);
  const part = next === low ? 0 : clamp((row - shown[low]) / (shown[next] - shown[low]), 0, 1);
  return { low, next, part };
}

let dirty = true;
function goTo(row) { state.row = clamp(row, 0, frames - 1); dirty = true; }
const here = () => Math.round(state.row);

function draw() {
  const { low, next, part } = pose(state.row), row = here();
  scene.pose(meshes, low, next, part, state);
  scene.draw(state);
  const seconds = (numbers[row] - numbers[0]) / facts.fps;
  $("now").textContent = `frame ${numbers[row]}   ${seconds.toFixed(2)} s   ${facts.labels[0]} ${millimetres(errors.mean[row])}   ${facts.labels[1]} ${millimetres(errors.max[row])}`;
  document.body.dataset.frame = numbers[row];
  const between = part > 0.001 && part < 0.999;
  $("badge").textContent = [...errors.flags[row].map((flag) => flag.replaceAll("_", " ")), between ? "mesh interpolated between stored frames" : ""]
    .filter(Boolean).join(" · ");
  for (const item of document.querySelectorAll(".frame")) item.classList.toggle("here", +item.dataset.row === row);
  if (!$("curves").hidden) for (const item of document.querySelectorAll(".control")) {
    const control = +item.dataset.control, { unit } = controls[control];
    item.querySelector(".meter i").style.width = `${100 * share(row, control)}%`;
    item.querySelector(".mm").textContent = `${valueAt(row, control).toFixed(unit ? 1 : 3)} ${unit}`;
  }
  drawPlot();
  drawTimeline();
}

function context(canvas) {
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = "11px Inter, 'Segoe UI', 'DejaVu Sans', sans-serif";
  return { pen, w, h };
}
const EDGE = 12;
const across = (row, w) => EDGE + (w - 2 * EDGE) * (frames > 1 ? row / (frames - 1) : 0);

function line(pen, w, height, from = 0, to = frames - 1) {
  pen.beginPath();
  const step = Math.max(1, Math.floor(frames / (4 * w)));
  for (let row = from; row <= to; row += step) pen.lineTo(across(row, w), height(row));
  pen.stroke();
}

function playhead(pen, w, h) {
  pen.strokeStyle = "#ffffffcc"; pen.lineWidth = 1;
  pen.beginPath(); pen.moveTo(across(state.row, w), 0); pen.lineTo(across(state.row, w), h); pen.stroke();
}

function drawPlot() {
  const { pen, w, h } = context($("plot")), height = (share) => h - 8 - (h - 26) * share;
  pen.strokeStyle = "#2a2e35";
  for (const level of [0, 0.5, 1]) { pen.beginPath(); pen.moveTo(EDGE, height(level)); pen.lineTo(w - EDGE, height(level)); pen.stroke(); }
  let left = EDGE;
  state.chosen.forEach((control, place) => {
    pen.strokeStyle = pen.fillStyle = PALETTE[place % PALETTE.length]; pen.lineWidth = 1.5;
    line(pen, w, (row) => height(share(row, control)));
    pen.fillText(controls[control].name, left, 12);
    left += pen.measureText(controls[control].name).width + 16;
  });
  if (!state.chosen.length) { pen.fillStyle = "#8d949f"; pen.fillText("Choose controls on the right to see their curves", EDGE, 12); }
  playhead(pen, w, h);
}

function drawTimeline() {
  const { pen, w, h } = context($("timeline"));
  const height = (mm, most) => h - 7 - (h - 23) * Math.min(mm / Math.max(most, 1e-9), 1);
  pen.fillStyle = "#e3a857";
  for (const row of flagged) pen.fillRect(across(row, w) - 0.75, h - 5, 1.5, 5);
  pen.lineWidth = 1;
  const said = (text, color, left) => { pen.fillStyle = color; pen.fillText(text, left, 12); return left + pen.measureText(text).width + 16; };
  let left = EDGE;
  for (const [name, values, most, color] of [[facts.labels[3], errors.max, facts.axis_mm[1], "#747c88"], [facts.labels[2], errors.mean, facts.axis_mm[0], "#d9634a"]]) {
    pen.strokeStyle = color;
    line(pen, w, (row) => height(values[row], most));
    left = said(`${name}, up to ${most.toPrecision(2)} mm`, color, left);
  }
  if (flagged.length) said("with a flag", "#e3a857", left);
  playhead(pen, w, h);
}

function button(parent, className, act) {
  const item = document.createElement("button");
  item.className = `row ${className}`;
  item.addEventListener("click", act);
  parent.append(item);
  return item;
}
function millimetres(value) { return value > 0 && value < 0.001 ? "<0.001 mm" : `${value} mm`; }

function put(parent, tag, className, text) {
  const item = document.createElement(tag);
  item.className = className; item.textContent = text;
  parent.append(item);
  return item;
}

function listClip() { // what was read: a line under the title, and all of it in a table
  if (!facts.clip) return;
  const { line, rows, warnings, notes } = facts.clip;
  $("clip-line").hidden = $("tab-clip").hidden = false;
  $("clip-line").textContent = line; $("clip-line").title = [line, ...warnings].join("\n");
  $("clip-line").classList.toggle("doubted", warnings.length > 0);
  for (const warning of warnings) put($("clip"), "p", "doubted", warning);
  const table = put($("clip"), "dl", "", "");
  for (const [name, value] of rows) { put(table, "dt", "", name); put(table, "dd", "", value); }
  for (const note of notes) put($("clip"), "p", "", note);
}

function listFrames() {
  const most = Math.max(...errors.worst.map((row) => errors.mean[row]), 1e-9);
  for (const [title, rows] of [["Worst frames", errors.worst], [`With a flag (${flagged.length})`, flagged.slice(0, 300)]]) {
    if (!rows.length) continue;
    put($("frames"), "h2", "", title);
    for (const row of rows) {
      const item = button($("frames"), "frame", () => { pause(); goTo(row); });
      item.dataset.row = row;
      put(item, "b", "", numbers[row]);
      put(put(item, "span", "meter", ""), "i", "", "").style.width = `${100 * Math.min(1, errors.mean[row] / most)}%`;
      put(item, "span", "mm", millimetres(errors.mean[row]));
      const region = errors.region[row] ? `, ${errors.region[row] === "still" ? "where no shape moves it" : errors.region[row]}` : "";
      const where = facts.scans.length ? "" : ` at vertex ${errors.vertex[row]}${region}`;
      put(item, "small", "", `${facts.labels[1]} ${millimetres(errors.max[row])}${where}`);
      if (errors.flags[row].length) put(item, "em", "", errors.flags[row].join(", ").replaceAll("_", " "));
    }
  }
}

function listControls() {
  const wanted = $("filter").value.toLowerCase();
  $("controls").replaceChildren();
  for (const control of order) {
    if (!controls[control].name.toLowerCase().includes(wanted)) continue;
    const item = button($("controls"), "control", () => {
      state.chosen = state.chosen.includes(control) ? state.chosen.filter((c) => c !== control) : [...state.chosen, control].slice(-8);
      listControls();
    });
    item.dataset.control = control;
    const place = state.chosen.indexOf(control);
    item.setAttribute("aria-pressed", place >= 0);
    put(item, "i", "dot", "").style.background = place < 0 ? "" : PALETTE[place % PALETTE.length];
    put(item, "span", "name", controls[control].name).title = controls[control].name;
    put(put(item, "span", "meter", ""), "i", "", "");
    put(item, "span", "mm", "");
  }
  dirty = true;
}

function pressed() {
  for (const name of ["target", "recovered", "both"]) $(`show-${name}`).setAttribute("aria-pressed", state.show === name);
  for (const name of ["heat", "wires"]) $(name).setAttribute("aria-pressed", state[name]);
  $("legend").hidden = !state.heat;
  $("top").textContent = `${state.top.toPrecision(2)} mm`;
  for (const [name, side] of [["target", 25], ["recovered", 75]]) {
    $(`tag-${name}`).hidden = state.show !== "both" && state.show !== name;
    $(`tag-${name}`).style.left = state.show === "both" ? `${side}%` : "50%";
  }
  $("play").textContent = state.playing ? "\u275a\u275a" : "\u25b6";
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  dirty = true;
}
function set(change) { Object.assign(state, change); pressed(); }
function pause() { set({ playing: false }); }
function play() { if (!state.playing && here() >= frames - 1) goTo(0); set({ playing: !state.playing }); }
function nextFlag(way) {
  const rows = flagged.length ? flagged : [...errors.worst].sort((a, b) => a - b);
  const found = way > 0 ? rows.find((row) => row > here()) : rows.findLast((row) => row < here());
  pause(); goTo(found ?? (way > 0 ? rows[0] : rows.at(-1)));
}
function nextWorst() {
  pause(); goTo(errors.worst[(errors.worst.indexOf(here()) + 1) % errors.worst.length]);
}
function tab(name) {
  for (const other of ["frames", "curves", "clip"]) { $(other).hidden = other !== name; $(`tab-${other}`).setAttribute("aria-selected", other === name); }
  dirty = true;
}

const keys = { " ": play, h: () => set({ heat: !state.heat }), e: () => set({ wires: !state.wires }), r: () => { scene.reset(); dirty = true; },
  1: () => set({ show: "target" }), 2: () => set({ show: "recovered" }), 3: () => set({ show: "both" }), f: () => nextFlag(1), w: nextWorst,
  arrowleft: (event) => { pause(); goTo(here() - (event.shiftKey ? 10 : 1)); }, arrowright: (event) => { pause(); goTo(here() + (event.shiftKey ? 10 : 1)); },
  home: () => goTo(0), end: () => goTo(frames - 1) };
addEventListener("keydown", (event) => {
  if (event.target.tagName === "INPUT" || event.ctrlKey || event.metaKey || event.altKey) return;
  const act = keys[event.key.toLowerCase()];
  if (act) { event.preventDefault(); act(event); }
});
for (const name of ["target", "recovered", "both"]) $(`show-${name}`).onclick = () => set({ show: name });
$("heat").onclick = keys.h; $("wires").onclick = keys.e; $("reset").onclick = keys.r; $("play").onclick = play;
$("next-flag").onclick = () => nextFlag(1); $("previous-flag").onclick = () => nextFlag(-1);
for (const name of ["frames", "curves", "clip"]) $(`tab-${name}`).onclick = () => tab(name);
$("clip-line").onclick = () => tab("clip");
$("filter").oninput = listControls;
$("heat-top").oninput = () => set({ top: facts.top_mm * 10 ** (($("heat-top").value - 50) / 50) });
for (const canvas of [$("plot"), $("timeline")]) {
  const scrub = (event) => { if (event.buttons) { pause(); goTo(Math.round((frames - 1) * (event.offsetX - EDGE) / (canvas.clientWidth - 2 * EDGE))); } };
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); scrub(event); });
  canvas.addEventListener("pointermove", scrub);
}
scene.onMove(() => { dirty = true; });
addEventListener("resize", () => { dirty = true; });
document.addEventListener("click", (event) => event.target.closest("button")?.blur()); // the space bar plays, whatever was clicked

document.title = `${facts.source} - riginv`;
$("source").textContent = facts.source; for (const item of document.querySelectorAll(".clip-name")) item.textContent = facts.labels[4]; $("about").textContent = facts.about; $("note").textContent = facts.note;
for (const [name, value] of facts.figures) { const item = put($("figures"), "div", "", ""); put(item, "b", "", value); put(item, "span", "", name); }
$("ramp").style.background = `linear-gradient(90deg, ${facts.heat.map(([r, g, b]) => `rgb(${r} ${g} ${b})`).join(", ")})`;
listFrames(); listControls(); listClip(); tab("frames"); pressed();
let before = performance.now();
function tick(now) {
  if (state.playing) { // in the time of the frames' numbers, which may leave some out
    const row = Math.min(Math.floor(state.row), frames - 2), apart = frames > 1 ? numbers[row + 1] - numbers[row] : 1;
    goTo(state.row + ((now - before) / 1000) * facts.fps / apart);
    if (state.row >= frames - 1) pause();
  }
  before = now;
  if (dirty) { dirty = false; draw(); }
  requestAnimationFrame(tick);
}
requestAnimationFrame(tick);
document.body.dataset.ready = "true";
})();
