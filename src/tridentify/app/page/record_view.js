// Middle: all chosen channels over time, with the ranges that are dragged on them.

import * as act from "./actions.js";
import { advise } from "./advice.js";
import { get, query } from "./api.js";
import { erase } from "./charts.js";
import { button, byId, fill, make } from "./dom.js";
import { fillOffers, findManoeuvres } from "./manoeuvres.js";
import { explain } from "./messages.js";
import { plain } from "./numbers.js";
import { dragging, fillRanges, kept, pieces, store } from "./ranges.js";
import { drawRecord, LEFT, RIGHT } from "./record_picture.js";
import { channelOf, listen, recordOf, state } from "./state.js";
import { extent, look, shifted, zoomed } from "./view.js";

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

let series = null; // what the server sent last
let request = null; // of samples under way
let clock = 0;
let drag = null; // { from, to } in pixels of the overlay
let plot, overlay, rangeList, offers, advice, readout, title, tools;

export function startRecordView() {
  plot = make("div", { class: "plot", role: "img", "aria-label": "Channels over time" });
  overlay = make("div", { class: "overlay", tabindex: "0", role: "application",
    "aria-label": "Record: arrow keys move, plus and minus zoom, 0 shows all of it, "
      + "Enter takes what is shown as the range" });
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
    fill(advice);
    overlay.hidden = !record;
    if (!record) blank();
  }
  title.textContent = record ? record.name : "Record";
  fillTools();
  fillRanges(rangeList);
  fillOffers(offers);
  fill(readout, HINTS[!record ? "none" : record.missing_file && !series ? "lost" : "read"]);
  if (!record) return;
  if (series?.of === drawnOf(record)) redraw(); // its ranges alone are others
  else refetch();
}

/** What of a record its samples are fetched for. */
const drawnOf = (record) => JSON.stringify([record.id, used(record), record.missing_file,
  record.content]);

function fillTools() {
  const record = recordOf();
  const modes = MODES.map(([name, text, help]) =>
    button(text, () => { dragging.mode = name; fillTools(); }, { title: help, class: `mode ${name}`,
      "aria-pressed": String(dragging.mode === name), "data-key": `mode ${name}`, disabled: !record }));
  fill(tools, make("div", { class: "group", role: "group", "aria-label": "What dragging does" }, modes),
    button("Whole record", () => look(null), { disabled: !record, "data-key": "whole" }),
    button("Check record", () => advise(record, advice), { disabled: !record, "data-key": "advise",
      title: "What the record is good for, before anything is estimated" }),
    button("Find manoeuvres", () => findManoeuvres(offers), { disabled: !record, "data-key": "find" }),
    box("several ranges", dragging.several, (on) => { dragging.several = on; },
      "A new range is added to those there are, as a further experiment"),
    box("estimate at once", dragging.atOnce, (on) => { dragging.atOnce = on; },
      "The estimate starts when a range to identify is released"));
}

function box(text, checked, change, help) {
  return make("label", { class: "box", title: help },
    make("input", { type: "checkbox", checked, "data-key": text,
      on: { change: (event) => change(event.target.checked) } }), text);
}

// ---------------------------------------------------------------- view
function moved() {
  redraw();
  refetchSoon();
}

function redraw() {
  const record = recordOf();
  if (record && series) drawRecord(plot, record, series);
}

/** What is looked at becomes what dragging over it would make of it. */
function taken() {
  const record = recordOf();
  if (!record || ["zoom", "move"].includes(dragging.mode)) return;
  const [start, end] = extent();
  released(record, { start: onSample(record, start), end: onSample(record, end) });
}

function byKey(event) {
  const keys = { ArrowLeft: () => shifted(-STEP), ArrowRight: () => shifted(STEP),
    "+": () => zoomed(0.5), "=": () => zoomed(0.5), "-": () => zoomed(2), 0: () => look(null),
    Enter: taken, Escape: () => endDrag(null) };
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
  if (dragging.mode === "zoom" || record.uniform === false || !record.dt) return time;
  return Number((Math.round(time / record.dt) * record.dt).toPrecision(12));
}

function dragTo(pixel) {
  drag.to = Math.min(inner(), Math.max(0, pixel));
  if (dragging.mode === "move") {
    const [start, end] = drag.extent;
    const by = (drag.from - drag.to) / inner() * (end - start);
    return look({ start: start + by, end: end + by });
  }
  const marked = overlay.firstChild;
  marked.className = `marked ${dragging.mode}`;
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
  if (pixel === null || dragging.mode === "move" || Math.abs(to - from) < LEAST_DRAG) return;
  const record = recordOf();
  const [start, end] = [Math.min(from, to), Math.max(from, to)].map((at) =>
    onSample(record, timeAt(at)));
  if (start < end) released(record, { start, end });
}

/** A piece that was dragged, or that is looked at when Enter is pressed, becomes what the mode says. */
function released(record, piece) {
  const { mode } = dragging;
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
