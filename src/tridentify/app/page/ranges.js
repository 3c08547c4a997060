// The pieces of a record: what is identified, what validates, what is left out.

import * as act from "./actions.js";
import { button, choice, fill, make } from "./dom.js";
import { warn } from "./messages.js";
import { plain, seconds } from "./numbers.js";
import { recordOf } from "./state.js";
import { extent, look } from "./view.js";

const USES = [["identify", "identify"], ["validate", "validate"], ["bad", "bad samples"]];

/** What dragging does. */
export const dragging = { mode: "identify", several: false, atOnce: true };

let place; // of the rows

/** All marked pieces of a record as one list. */
export const pieces = (record) => [
  ...(record?.ranges ?? []), ...(record?.bad ?? []).map((one) => ({ ...one, use: "bad" }))];

/** The pieces of the record looked at, as rows of numbers. */
export function fillRanges(list) {
  place = list;
  const record = recordOf();
  if (!record) return fill(place);
  const all = pieces(record);
  const rows = all.map((piece, number) => rangeRow(record, all, number));
  fill(place, rows.length ? rows : make("p", { class: "soft" },
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
      return fillRanges(place);
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
export function store(record, all, estimate) {
  const split = (wanted) => all.filter((one) => (one.use === "bad") === wanted)
    .sort((one, other) => one.start - other.start);
  const ranges = split(false).map(({ start, end, use }) => ({ start, end, use }));
  const bad = split(true).map(({ start, end }) => ({ start, end }));
  const changes = {};
  if (JSON.stringify(ranges) !== JSON.stringify(record.ranges)) changes.ranges = ranges;
  if (JSON.stringify(bad) !== JSON.stringify(record.bad)) changes.bad = bad;
  const anything = Object.keys(changes).length > 0;
  if (estimate && dragging.atOnce) return act.estimate(anything ? changes : null);
  if (anything) return act.changeRecord(record.id, changes);
}

/** The pieces that stay when one of a use is dragged. */
export const kept = (record, use) =>
  pieces(record).filter((one) => dragging.several || one.use !== use);
