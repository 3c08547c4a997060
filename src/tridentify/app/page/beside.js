// Coefficients of several models side by side, and their comparison on another record.

import { attempt } from "./actions.js";
import { post } from "./api.js";
import { breakable, button, choice, fill, make, table } from "./dom.js";
import { passing } from "./messages.js";
import { percent, withError, withUnit } from "./numbers.js";
import { suits } from "./pair.js";
import { distinct } from "./panel_parts.js";
import { recordOf, shownModels, state, tell } from "./state.js";

const MOST_BESIDE = 2; // outputs that fit side by side into the narrowest panel
const FITS = { "aria-label": "Fits on the other record" };

let compared = null; // id of the record to compare on
let beside;

/** The place of the table. */
export function startBeside() {
  beside = make("section", { class: "panel beside", "aria-label": "Models side by side" });
  return beside;
}

/** Coefficients of the ticked models, and what they do on another record. */
export function fillBeside(models, details) {
  const names = distinct([...details].sort((one, other) =>
    other.parameters.length - one.parameters.length)
    .flatMap((one) => one.parameters.map((row) => row.name)));
  const rowOf = (detail, name) => detail.parameters.find((one) => one.name === name);
  const units = (name) => distinct(details.map((one) => rowOf(one, name)?.unit).filter(Boolean));
  const cell = (detail, name) => {
    const row = rowOf(detail, name);
    if (!row) return "\u2013";
    const [value, std] = withError(row.value, row.std);
    const unit = units(name).length > 1 ? ` ${row.unit}` : "";
    return (std ? `${value} \u00b1\u00a0${std}` : value) + unit;
  };
  const fits = make("div", { class: "fits", "aria-live": "polite" }, comparison(models));
  beside.classList.toggle("wide", models.length > 2);
  fill(beside, make("h3", {}, "Coefficients side by side"),
    table(["", ...models.map((model) => model.name)],
      names.map((name) => [breakable(withUnit(name, units(name).length === 1 ? units(name)[0] : "")), ...details.map((one) => cell(one, name))]),
      { "aria-label": "Coefficients side by side", class: "coefficients" }),
    make("div", { class: "tools" }, "Compare on ",
      choice(state.session.records.map(({ id, name }) => [id, name]), target(models),
        (id) => { compared = id; }, { "aria-label": "Record to compare on", "data-key": "target" }),
      button("Compare", compare, { "data-key": "compare" })),
    make("p", { class: "soft" }, "Offset, drift and the initial state are fitted anew on that record."),
    fits);
}

const target = (models) =>
  recordOf(compared)?.id ?? state.record ?? models[0].record;

async function compare() {
  const models = shownModels();
  const record = target(models);
  if (!suits(record)) return;
  const done = passing();
  await attempt(async () => {
    const ids = models.map((one) => one.id);
    const found = await post("/compare", { models: ids, record });
    done();
    state.compared = { models: ids, record, ...found };
    fill(beside.querySelector(".fits"), comparison(shownModels()));
    tell("compared");
  });
}

/** What the last comparison found, where it was one of these models. */
function comparison(models) {
  const found = state.compared;
  if (!found || String(found.models) !== String(models.map((one) => one.id))) return [];
  const upright = found.outputs.length <= MOST_BESIDE;
  const rows = upright
    ? table(["", ...found.outputs.map((name) => `fit ${name}`)],
      models.map((model, at) => [model.name, ...found.fits[at].map(percent)]), FITS)
    : table(["fit of", ...models.map((model) => model.name)],
      found.outputs.map((name, at) => [breakable(name),
        ...found.fits.map((fits) => percent(fits[at]))]), FITS);
  return [rows, make("p", {}, found.summary ?? "")];
}
