// Right: one sentence, measured against model, the numbers that matter, doubts, coefficients.

import { attempt } from "./actions.js";
import { band, colour, draw, erase, axis, fitting, FIXED, layout, line, modelColour, safe }
  from "./charts.js";
import { detailOf, panelOf } from "./details.js";
import { breakable, byId, fill, make, table } from "./dom.js";
import { findingList, worst } from "./findings.js";
import { brief, hasUnit, percent, plain, withError, withUnit } from "./numbers.js";
import { isDone, listen, modelOf, recordOf, state } from "./state.js";

const HEIGHT = 190; // pixels of measured against model, one output
const TABLES = [["parameters", "Coefficients", "coefficient"], ["derived", "Derived", "quantity"],
  ["physical", "Physical parameters", "parameter"]];

let body, picture, legend, head, tail;
let drawn = 0;
let pictured = null; // id of the model whose fit is drawn

export function startResult() {
  picture = make("div", { class: "plot small", role: "img", "aria-label": "Measured against model" });
  legend = make("p", { class: "legend soft" });
  head = make("div", { class: "head" });
  tail = make("div", { class: "tail" });
  body = make("div", { class: "found" }, head, make("div", { class: "measured" }, picture, legend), tail);
  byId("result").append(make("h2", {}, "Result"), body);
  listen(["result", "models", "theme"], refresh);
}

async function refresh() {
  const model = modelOf();
  const turn = ++drawn;
  if (!model || !isDone(model)) return empty(model);
  await attempt(async () => {
    const fit = model.older_file ? null : panelOf(model.id, "fit", model.record);
    fit?.catch(() => null); // told below, once the words are there
    const detail = await detailOf(model.id);
    if (turn !== drawn) return;
    show(model, detail);
    if (detail.pictures === false) return withoutPicture();
    if (pictured !== model.id) awaitPicture();
    const found = await (fit ?? panelOf(model.id, "fit", model.record));
    if (turn !== drawn) return;
    await drawFit(model, found);
    pictured = model.id;
    picture.removeAttribute("aria-busy");
  });
}

/** The place of the picture is there from the first: what follows it does not move. */
function awaitPicture() {
  picture.setAttribute("aria-busy", "true");
  picture.hidden = false;
  picture.style.height ||= `${HEIGHT + 40}px`;
}

function withoutPicture() {
  erase(picture);
  pictured = null;
  picture.hidden = legend.hidden = true;
}

function empty(model) {
  withoutPicture();
  fill(tail);
  fill(head, make("p", { class: "soft" }, model
    ? `${model.name}: ${model.state}` : "No model yet. Drag over the part of the record in which "
      + "the plant was moved; what was found is shown here as soon as you let go."));
}

function show(model, detail) {
  fill(head, make("h3", { class: "named" }, name(model)),
    detail.older_file ? make("p", { class: "bad" }, detail.older_file) : null,
    make("p", { class: `sentence ${worst(detail.findings)}` },
      detail.sentence.replace(/(\d) %/g, "$1\u00a0%")));
  fill(tail, numbers(detail), doubts(model, detail.findings), checked(model, detail),
    ...TABLES.flatMap(([place, title, first]) =>
      section(title, parameters(title, first, detail[place]))),
    (detail.physical_notes ?? []).map((text) => make("p", { class: "soft" }, text)));
}

function name(model) {
  const record = recordOf(model.record);
  return record ? `${model.name}, ${record.name}` : model.name;
}

function numbers({ numbers: four }) {
  if (!four?.length) return null;
  return make("dl", { class: "numbers" }, four.map((one) => {
    const [value, std] = withError(one.value, one.std);
    return make("div", {}, make("dt", {}, breakable(one.name)),
      make("dd", {}, value, [std ? `\u00b1 ${std}` : "", hasUnit(one.unit) ? one.unit : ""]
        .filter(Boolean).flatMap((text) => [" ", make("span", {}, text)])));
  }));
}

function doubts(model, findings) {
  if (!findings?.length) {
    return make("p", { class: "fine" }, "Nothing was found that speaks against these numbers.");
  }
  return [make("h3", {}, "Doubts"), findingList(findings, model)];
}

function checked(model, detail) {
  if (!detail.validation_fit) return null;
  return [make("h3", {}, "On the range for validation"),
    make("p", {}, fitsOf(detail.outputs, detail.validation_fit)),
    detail.validation_note ? make("p", { class: "bad" }, detail.validation_note) : null,
    findingList(detail.validation_findings, model)];
}

function section(title, content) {
  return content ? [make("h3", {}, title), content] : [];
}

const USUAL = ["free", "estimated", "ok"];

function parameters(title, first, rows) {
  if (!rows?.length) return null;
  return table([`${first} [unit]`, "value \u00b1 std error", "95 % from", "to"], rows.map((row) => {
    const [value, std] = withError(row.value, row.std);
    const status = USUAL.includes(row.status ?? "free") ? "" : `, ${row.status}`;
    return [breakable(withUnit(row.name, row.unit) + status), std ? `${value} \u00b1\u00a0${std}` : value,
      limit(row, row.low), limit(row, row.high)];
  }), { "aria-label": title, class: "coefficients" });
}

/** A limit with the digits of the value it belongs to. */
function limit(row, value) {
  return row.std > 0 && Number.isFinite(value) ? withError(value, row.std)[0] : plain(value);
}

async function drawFit(model, { outputs }) {
  picture.hidden = legend.hidden = false;
  const chosen = outputs.filter((one) => outputs.length < 4 || one.name === state.output);
  const rows = chosen.length ? chosen : outputs.slice(0, 1);
  const traces = rows.flatMap((one, row) => {
    const at = { yaxis: row ? `y${row + 1}` : "y" };
    const tone = modelColour(model);
    return [...band(one.time, one.low, one.high, tone, at),
      line(one.time, one.measured, colour("measured"), { ...at, line: { width: 1 } }),
      line(one.time, one.model, tone, at)];
  });
  const height = HEIGHT * Math.min(rows.length, 2) + 40;
  picture.style.height = `${height}px`;
  const made = layout({ height, margin: { l: 58, r: 8, t: 6, b: 36 } });
  made.xaxis = axis("time [s]", { anchor: rows.length > 1 ? `y${rows.length}` : "y" });
  rows.forEach((one, row) => {
    made[row ? `yaxis${row + 1}` : "yaxis"] = axis(withUnit(brief(one.name, fitting(HEIGHT)), one.unit), {
      domain: [1 - (row + 0.92) / rows.length, 1 - row / rows.length], nticks: 5 });
  });
  await draw(picture, traces, made, FIXED);
  const swatch = (tone) => {
    const node = make("span", { class: "swatch", "aria-hidden": "true" });
    node.style.background = tone;
    return node;
  };
  fill(legend, swatch(colour("measured")), "measured ", swatch(modelColour(model)), "model ",
    fitsOf(outputs.map((one) => one.name), model.fit ?? []));
}

/** The fit of each output, by name where there are several. */
function fitsOf(names, fits) {
  if (!fits.length) return "";
  const told = fits.map((fit, at) => (fits.length > 1 ? `${names[at]} ` : "") + percent(fit));
  return `fit ${told.join(", ")}`;
}
