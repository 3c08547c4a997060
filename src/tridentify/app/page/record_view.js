// Middle: all chosen channels over time, with the ranges that are dragged on them.

import * as act from "./actions.js";
import { advise } from "./advice.js";
import { get, query } from "./api.js";
import { axis, colour, draw, erase, faint, FIXED, layout, line, safe } from "./charts.js";
import { button, byId, choice, fill, make } from "./dom.js";
import { explain, note, warn } from "./messages.js";
import { brief, count, plain, seconds, withUnit } from "./numbers.js";
import { channelOf, listen, recordOf, state, tell } from "./state.js";

const LEFT = 62; // pixels of the numbers beside the channels
const RIGHT = 10;
const TOP = 6;
const BOTTOM = 38;
const ROW = 112; // pixels of one channel
const HIGHEST = 620; // pixels of all channels, as long as each keeps LOWEST
const LOWEST = 64;
const MOST = 48; // letters of a name above its channel
const GAP = 0.16; // of a row, for the channel's name
const LEAST_DRAG = 4; // pixels: less is a click
const SETTLED = 60; // milliseconds without a new view before samples are fetched
const STEP = 0.15; // of the view, for an arrow key

const MODES = [
  ["identify", "Identify", "Drag over what is identified; the estimate starts on release"],
  ["validate", "Validate", "Drag over what the model is tested on"],
  ["bad", "Bad samples", "Drag over samples that are left out"],
  ["zoom", "Zoom", "Drag over what is looked at closer"],
  ["move", "Move", "Drag the record along"],
];
const HINTS = {
  none: "Open a file on the left, or drop one here.",
  lost: "The samples are shown here again when the file is back where it was.",
  read: "",
};
const USES = [["identify", "identify"], ["validate", "validate"], ["bad", "bad samples"]];
const COLOURS = { identify: "identify", validate: "validate", bad: "bad" };

let mode = "identify";
let several = false;
let atOnce = true;
let series = null; // what the server sent last
let request = null; // of samples under way
let clock = 0;
let drag = null; // { from, to } in pixels of the overlay
let manoeuvres = null;
let plot, overlay, rangeList, offers, advice, readout, title, tools;

export function startRecordView() {
  plot = make("div", { class: "plot", role: "img", "aria-label": "Channels over time" });
  overlay = make("div", { class: "overlay", tabindex: "0", role: "application",
    "aria-label": "Record: arrow keys move, plus and minus zoom, 0 shows all of it" });
  overlay.append(make("div", { class: "marked" }));
  title = make("h2", {}, "Record");
  readout = make("p", { class: "readout soft", "aria-hidden": "true" });
  tools = make("div", { class: "tools", role: "toolbar", "aria-label": "Record" });
  rangeList = make("div", { class: "ranges" });
  advice = make("div", { class: "advice", "aria-live": "polite" });
  offers = make("div", { class: "offers", "aria-live": "polite" });
  byId("record").append(title, tools, make("div", { class: "drawing" }, plot, overlay), readout,
    rangeList, offers, advice);
  listenToPointer();
  overlay.addEventListener("keydown", byKey);
  listen("record", changed);
  listen("view", moved);
  listen("theme", redraw);
  new ResizeObserver(() => { if (series) refetchSoon(); }).observe(plot);
  changed();
}

// ---------------------------------------------------------------- the parts
let shownId = null;

function changed() {
  const record = recordOf();
  if (record?.id !== shownId) {
    shownId = record?.id ?? null;
    series = null;
    manoeuvres = null;
    fill(advice);
    overlay.hidden = !record;
    if (!record) blank();
  }
  title.textContent = record ? record.name : "Record";
  fillTools();
  fillRanges();
  fillOffers();
  fill(readout, HINTS[!record ? "none" : record.missing_file && !series ? "lost" : "read"]);
  if (!record) return;
  if (series?.of === drawnOf(record)) redraw(); // its ranges alone are others
  else refetch();
}

/** What of a record its samples are fetched for. */
const drawnOf = (record) => JSON.stringify([record.id, used(record), record.missing_file]);

function fillTools() {
  const record = recordOf();
  const modes = MODES.map(([name, text, help]) =>
    button(text, () => { mode = name; fillTools(); }, { title: help, class: `mode ${name}`,
      "aria-pressed": String(mode === name), "data-key": `mode ${name}`, disabled: !record }));
  fill(tools, make("div", { class: "group", role: "group", "aria-label": "What dragging does" }, modes),
    button("Whole record", () => look(null), { disabled: !record, "data-key": "whole" }),
    button("Check record", () => advise(record, advice), { disabled: !record, "data-key": "advise",
      title: "What the record is good for, before anything is estimated" }),
    button("Find manoeuvres", findManoeuvres, { disabled: !record, "data-key": "find" }),
    box("several ranges", several, (on) => { several = on; },
      "A new range is added to those there are, as a further experiment"),
    box("estimate at once", atOnce, (on) => { atOnce = on; },
      "The estimate starts when a range to identify is released"));
}

function box(text, checked, change, help) {
  return make("label", { class: "box", title: help },
    make("input", { type: "checkbox", checked, "data-key": text,
      on: { change: (event) => change(event.target.checked) } }), text);
}

/** All marked pieces of a record as one list. */
const pieces = (record) => [
  ...(record?.ranges ?? []), ...(record?.bad ?? []).map((one) => ({ ...one, use: "bad" }))];

function fillRanges() {
  const record = recordOf();
  if (!record) return fill(rangeList);
  const all = pieces(record);
  const rows = all.map((piece, number) => rangeRow(record, all, number));
  fill(rangeList, rows.length ? rows : make("p", { class: "soft" },
    "The whole record is identified. Drag over a part of it to use that part alone."),
  overlap(record),
  button("Add range", () => addByHand(record), { class: "link", "data-key": "add range" }));
}

/** Says where what validates is identified, too. */
function overlap({ ranges }) {
  const [made, tested] = ["identify", "validate"].map((wanted) =>
    ranges.filter(({ use }) => use === wanted));
  const shared = made.flatMap((one) => tested.map((other) =>
    [Math.max(one.start, other.start), Math.min(one.end, other.end)]))
    .filter(([start, end]) => start < end);
  const where = shared.map(([start, end]) => `${plain(start)} to ${seconds(end)}`).join(" and ");
  if (!shared.length && (made.length || !tested.length)) return null;
  return make("p", { class: "bad" }, shared.length
    ? `What is identified and what validates share ${where}; a model is tested by what it was not `
      + "made from: move one of the ranges."
    : "The whole record is identified, the range for validation with it; drag over what is to be "
      + "identified.");
}

function rangeRow(record, all, number) {
  const piece = all[number];
  const change = (changes) => {
    const next = { ...piece, ...changes };
    if (!(next.start < next.end)) {
      warn(`The range would end at ${seconds(next.end)} before it starts at ${seconds(next.start)}; `
        + "give an end that is later.", "range");
      return fillRanges();
    }
    store(record, all.map((one, at) => (at === number ? next : one)), next.use === "identify");
  };
  const field = (name) => make("input", { type: "number", step: "any", value: rounded(piece[name]),
    "aria-label": `${name} of range ${number + 1} in seconds`, "data-key": `${name} ${number}`,
    on: { change: (event) => change({ [name]: Number(event.target.value) }) } });
  const swatch = make("span", { class: `swatch ${piece.use}`, "aria-hidden": "true" });
  return make("div", { class: "row range" }, swatch,
    choice(USES, piece.use, (use) => change({ use }),
      { "aria-label": `use of range ${number + 1}`, "data-key": `use ${number}` }),
    field("start"), "to", field("end"), "s",
    button("Show", () => look(piece), { class: "link", "data-key": `show ${number}` }),
    button("\u00d7", () => store(record, all.filter((_, at) => at !== number), false),
      { class: "quiet", "aria-label": `Remove range ${number + 1}`,
        "data-key": `remove ${number}` }));
}

const rounded = (value) => Number(value.toPrecision(7));

function addByHand(record) {
  const [start, end] = extent();
  const third = (end - start) / 3;
  store(record, [...pieces(record), { start: start + third, end: end - third, use: "identify" }], false);
}

/** Keeps the pieces of a record, then estimates where the identified ones changed. */
function store(record, all, estimate) {
  const split = (wanted) => all.filter((one) => (one.use === "bad") === wanted)
    .sort((one, other) => one.start - other.start);
  const ranges = split(false).map(({ start, end, use }) => ({ start, end, use }));
  const bad = split(true).map(({ start, end }) => ({ start, end }));
  const changes = {};
  if (JSON.stringify(ranges) !== JSON.stringify(record.ranges)) changes.ranges = ranges;
  if (JSON.stringify(bad) !== JSON.stringify(record.bad)) changes.bad = bad;
  const anything = Object.keys(changes).length > 0;
  if (estimate && atOnce) return act.estimate(anything ? changes : null);
  if (anything) return act.changeRecord(record.id, changes);
}

// ---------------------------------------------------------------- manoeuvres
async function findManoeuvres() {
  const record = recordOf();
  const problem = act.obstacle(record);
  if (problem) return warn(problem, "estimate");
  note("Looking for manoeuvres ...");
  await act.attempt(async () => {
    manoeuvres = await get(`/records/${record.id}/manoeuvres`);
    note("");
    fillOffers();
  });
}

function fillOffers() {
  const record = recordOf();
  if (!record || manoeuvres === null) return fill(offers);
  if (!manoeuvres.length) {
    return fill(offers, make("p", {}, "No manoeuvre was found: nowhere does an input move "
      + "after a quiet stretch with an answer above the noise."));
  }
  const use = (one) => store(record, [...kept(record, "identify"), { ...one, use: "identify" }], true);
  fill(offers, make("h3", {}, count(manoeuvres.length, "manoeuvre")),
    make("ul", {}, manoeuvres.map((one, number) => make("li", {},
      button(`${plain(one.start)} to ${plain(one.end)} s`, () => look(one),
        { class: "link", "data-key": `look ${number}` }),
      make("span", { class: "soft" }, ` ${one.why} `),
      button("Identify", () => use({ start: one.start, end: one.end }),
        { "data-key": `take ${number}` })))),
    button("Use all as experiments", () => store(record, [
      ...pieces(record).filter((one) => one.use !== "identify"),
      ...manoeuvres.map(({ start, end }) => ({ start, end, use: "identify" }))], true),
    { "data-key": "take all" }));
}

const kept = (record, use) =>
  pieces(record).filter((one) => several || one.use !== use);

// ---------------------------------------------------------------- view
/** Start and end of the whole record, in seconds. */
const whole = () => [0, recordOf()?.duration ?? 1];
const extent = () => (state.view ? [state.view.start, state.view.end] : whole());

function look(view) {
  const [first, last] = whole();
  if (!view) state.view = null;
  else {
    const record = recordOf();
    const least = Math.max((record.dt || 0) * 4, (last - first) * 1e-7);
    const width = Math.min(Math.max(view.end - view.start, least), last - first);
    const start = Math.min(Math.max(view.start, first), last - width);
    state.view = width >= last - first ? null : { start, end: start + width };
  }
  tell("view");
}

function moved() {
  redraw();
  refetchSoon();
}

function zoomed(by, at = 0.5) {
  const [start, end] = extent();
  const centre = start + at * (end - start);
  look({ start: centre - (centre - start) * by, end: centre + (end - centre) * by });
}

function shifted(by) {
  const [start, end] = extent();
  look({ start: start + by * (end - start), end: end + by * (end - start) });
}

function byKey(event) {
  const keys = { ArrowLeft: () => shifted(-STEP), ArrowRight: () => shifted(STEP),
    "+": () => zoomed(0.5), "=": () => zoomed(0.5), "-": () => zoomed(2), 0: () => look(null),
    Escape: () => endDrag(null) };
  if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  keys[event.key]();
}

// ---------------------------------------------------------------- samples
const used = (record) => {
  const names = [...record.inputs, ...record.references, ...record.outputs];
  return names.length ? [...new Set(names)] : record.channels.slice(0, 4).map((one) => one.name);
};

function refetchSoon() {
  clearTimeout(clock);
  clock = setTimeout(refetch, SETTLED);
}

async function refetch() {
  const record = recordOf();
  if (!record) return;
  request?.abort();
  request = new AbortController();
  const [start, end] = extent();
  const pixels = Math.max(200, Math.round(plot.clientWidth - LEFT - RIGHT));
  const names = used(record);
  const of = drawnOf(record);
  try {
    const found = await get(`/records/${record.id}/series${query({
      channels: names.join(","), start, end, pixels })}`, request.signal);
    if (record.id !== state.record) return;
    series = { ...found, names, of };
    redraw();
  } catch (error) {
    if (error.code === "gone") act.knock();
    if (error.name !== "AbortError" && !series) blank();
    explain(error);
  }
}

/** Nothing in place of the samples of a record that was shown before. */
function blank() {
  erase(plot);
  plot.style.height = "";
}

/** Minimum and maximum of each pixel column as one line. */
function curve(time, { minimum, maximum }, thinned) {
  if (!thinned) return [time, minimum];
  const x = new Array(2 * time.length);
  const y = new Array(2 * time.length);
  for (let k = 0; k < time.length; k++) {
    x[2 * k] = x[2 * k + 1] = time[k];
    y[2 * k] = minimum[k];
    y[2 * k + 1] = maximum[k];
  }
  return [x, y];
}

// ---------------------------------------------------------------- drawing
const heightOf = (rows) =>
  Math.max(rows * LOWEST, Math.min(rows * ROW, HIGHEST)) + TOP + BOTTOM;

function redraw() {
  const record = recordOf();
  if (!record || !series) return;
  const rows = series.names.filter((name) => series.channels[name]);
  const height = heightOf(rows.length);
  plot.style.height = `${height}px`;
  draw(plot, rows.map(trace), shape(record, rows, height), FIXED);
}

const axisName = (row) => `y${row ? row + 1 : ""}`;

function trace(name, row) {
  const record = recordOf();
  const [x, y] = curve(series.time, series.channels[name], series.thinned);
  const ink = record.outputs.includes(name) ? "ink" : "moved";
  const held = record.inputs.includes(name) && record.intersample === "zoh" && !series.thinned;
  return line(x, y, colour(ink), { yaxis: axisName(row), name: safe(name), connectgaps: false,
    line: { width: 1.1, shape: held ? "hv" : "linear" } });
}

function shape(record, rows, height) {
  const made = layout({ height, margin: { l: LEFT, r: RIGHT, t: TOP, b: BOTTOM },
    shapes: marks(record), annotations: rows.map((name, row) => label(record, rows, name, row)) });
  made.xaxis = axis("time [s]", { range: extent(), automargin: false,
    anchor: axisName(rows.length - 1) });
  rows.forEach((name, row) => {
    made[row ? `yaxis${row + 1}` : "yaxis"] = axis("", { domain: domain(rows, row), nticks: 4,
      automargin: false, zeroline: false, exponentformat: "e" });
  });
  return made;
}

const domain = (rows, row) =>
  [1 - (row + 1) / rows.length, 1 - (row + GAP) / rows.length];

function label(record, rows, name, row) {
  const { unit } = channelOf(record, name);
  const role = [["inputs", "input"], ["references", "reference"], ["outputs", "output"]]
    .find(([place]) => record[place].includes(name))?.[1] ?? "unused";
  return { xref: "paper", yref: "paper", x: 0, y: domain(rows, row)[1], xanchor: "left",
    yanchor: "bottom", showarrow: false, font: { size: 11 }, borderpad: 0,
    text: `<b>${safe(withUnit(brief(name, MOST), unit))}</b> ${role}` };
}

function marks(record) {
  return pieces(record).map(({ start, end, use }) => ({
    type: "rect", xref: "x", yref: "paper", x0: start, x1: end, y0: 0, y1: 1, layer: "below",
    fillcolor: faint(colour(COLOURS[use]), use === "bad" ? 0.35 : 0.2),
    line: { width: 1, color: colour(COLOURS[use]), dash: use === "bad" ? "dot" : "solid" } }));
}

// ---------------------------------------------------------------- pointer
const inner = () => overlay.clientWidth;

function timeAt(pixel) {
  const [start, end] = extent();
  return start + Math.min(1, Math.max(0, pixel / inner())) * (end - start);
}

const pixelOf = (event) => event.clientX - overlay.getBoundingClientRect().left;

function listenToPointer() {
  overlay.addEventListener("pointerdown", (event) => {
    if (event.button || !recordOf()) return;
    overlay.setPointerCapture(event.pointerId);
    const pixel = pixelOf(event);
    drag = { from: pixel, to: pixel, extent: extent() };
  });
  overlay.addEventListener("pointermove", (event) => {
    if (drag) dragTo(pixelOf(event));
    else tellValues(pixelOf(event));
  });
  overlay.addEventListener("pointerup", (event) => { if (drag) endDrag(pixelOf(event)); });
  overlay.addEventListener("pointercancel", () => endDrag(null));
  overlay.addEventListener("dblclick", () => look(null));
  overlay.addEventListener("wheel", (event) => {
    if (!recordOf()) return;
    event.preventDefault();
    zoomed(event.deltaY > 0 ? 1.25 : 0.8, pixelOf(event) / inner());
  }, { passive: false });
}

/** The time of the nearest sample, where they are evenly spaced. */
function onSample(record, time) {
  if (mode === "zoom" || record.uniform === false || !record.dt) return time;
  return Number((Math.round(time / record.dt) * record.dt).toPrecision(12));
}

function dragTo(pixel) {
  drag.to = Math.min(inner(), Math.max(0, pixel));
  if (mode === "move") {
    const [start, end] = drag.extent;
    const by = (drag.from - drag.to) / inner() * (end - start);
    return look({ start: start + by, end: end + by });
  }
  const marked = overlay.firstChild;
  marked.className = `marked ${mode}`;
  marked.style.left = `${Math.min(drag.from, drag.to)}px`;
  marked.style.width = `${Math.abs(drag.to - drag.from)}px`;
  fill(readout, `${plain(timeAt(Math.min(drag.from, drag.to)))} to `
    + `${plain(timeAt(Math.max(drag.from, drag.to)))} s`);
}

function endDrag(pixel) {
  if (!drag) return;
  if (pixel !== null) dragTo(pixel);
  const { from, to } = drag;
  drag = null;
  overlay.firstChild.className = "marked";
  if (pixel === null || mode === "move" || Math.abs(to - from) < LEAST_DRAG) return;
  const record = recordOf();
  const [start, end] = [Math.min(from, to), Math.max(from, to)].map((at) =>
    onSample(record, timeAt(at)));
  if (start < end) released(record, { start, end });
}

function released(record, piece) {
  if (mode === "zoom") return look(piece);
  const others = mode === "bad" ? pieces(record) : kept(record, mode);
  return store(record, [...others, { ...piece, use: mode }], mode === "identify" || mode === "bad");
}

function tellValues(pixel) {
  const record = recordOf();
  if (!record || !series?.time.length) return;
  const time = timeAt(pixel);
  const at = nearest(series.time, time);
  const values = series.names.filter((name) => series.channels[name]).map((name) => {
    const { minimum, maximum } = series.channels[name];
    const { unit } = channelOf(record, name);
    const text = minimum[at] === maximum[at] ? plain(minimum[at])
      : `${plain(minimum[at])} to ${plain(maximum[at])}`;
    return `${name} ${text} ${unit ?? ""}`.trim();
  });
  fill(readout, [`${plain(time)} s`, ...values].join("   "));
}

function nearest(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] > time) high = middle;
    else low = middle;
  }
  return time - times[low] < times[high] - time ? low : high;
}
