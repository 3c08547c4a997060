// What the pictures below have in common: which record and which pair they show, and how.

import { erase, layout, modelDash, safe } from "./charts.js";
import { fill, make } from "./dom.js";
import { recordOf, state } from "./state.js";

export const HEIGHT = 300; // pixels of a picture

/** The record on which all models are shown; null: each on the one it was estimated from. */
export const shown = { record: null };

export const recordFor = (model) => shown.record ?? model.record;

export const distinct = (names) => [...new Set(names)];

const isChosen = (one) => one.output === state.output && one.input === state.input;
export const pairOf = (data) => data.pairs.find(isChosen) ?? null;
export const outputOf = (data) => data.outputs.find((one) => one.name === state.output) ?? null;
export const styled = (model, more = {}) => ({ ...more, name: safe(model.name),
  line: { dash: modelDash(model), ...more.line } });

export function told(place, ...lines) {
  fill(place.told, lines.flat().filter(Boolean));
}

/** The layout of a picture whose place keeps its height when the window changes. */
export function sized(place, height, more = {}) {
  place.plot.style.height = `${height}px`;
  return layout({ height, ...more });
}

/** The models that have what is shown: `{ model, one }`. */
export const having = (all, find) =>
  all.map(({ model, data }) => ({ model, one: find(data) })).filter(({ one }) => one);

/** Units of the output and the input that are shown. */
export function unitsOf(model) {
  const record = recordOf(model.record);
  return [state.output, state.input].map((name) =>
    record?.channels.find((one) => one.name === name)?.unit);
}

export function nothing(place) {
  erase(place.plot);
  place.plot.style.height = "";
  told(place, make("p", { class: "soft" }, "None of the ticked models has this output and input."));
}
