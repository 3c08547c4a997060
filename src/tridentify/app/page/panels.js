// Below: linked panels of all ticked models, and their coefficients side by side.

import { attempt } from "./actions.js";
import { post } from "./api.js";
import * as chart from "./charts.js";
import { band, colour, dots, draw, erase, axis, fitting, layout, line, modelColour, modelDash, safe }
  from "./charts.js";
import { detailOf, panelOf } from "./details.js";
import { breakable, button, byId, choice, fill, make, table } from "./dom.js";
import { passing, warn } from "./messages.js";
import { brief, hasUnit, percent, perUnit, ratioOf, withError, withUnit } from "./numbers.js";
import { listen, recordOf, shownModels, state, tell } from "./state.js";

const HEIGHT = 300; // pixels of a picture
const MOST_BESIDE = 2; // outputs that fit side by side into the narrowest panel
const FITS = { "aria-label": "Fits on the other record" };
const PANELS = [
  ["fit", "Fit", drawFit],
  ["residual", "Residual", drawResidual],
  ["bode", "Bode", drawBode],
  ["step", "Step response", drawStep],
  ["poles", "Poles and zeros", drawPoles],
];

const cards = new Map();
let chosenRecord = null; // null: the record each model was estimated from
let head, empty, grid, beside, turn = 0;

export function startPanels() {
  head = make("div", { class: "tools" });
  empty = make("p", { class: "soft" }, "Tick a model on the left to see it here; several are overlaid.");
  grid = make("div", { class: "grid" });
  for (const [name, title] of PANELS) grid.append(card(name, title));
  beside = make("section", { class: "panel beside", "aria-label": "Models side by side" });
  grid.append(beside);
  byId("panels").append(make("h2", {}, "Panels"), head, empty, grid);
  listen(["models", "judged", "theme", "result"], soon);
  listen("pair", refresh);
}

function card(name, title) {
  const plot = make("div", { class: "plot", role: "img", "aria-label": title });
  const told = make("div", { class: "told" });
  const panel = make("section", { class: "panel", "aria-label": title, "data-panel": name },
    make("h3", {}, title), plot, told);
  cards.set(name, { plot, told, panel, shows: null });
  return panel;
}

/** What a picture shows: the same models on the same records. */
const shownBy = (models) => String(models.map((model) => [model.id, recordFor(model)]));

/** A picture of other models says so until its own is there. */
function awaitPanels(models) {
  for (const place of cards.values()) {
    if (place.shows === shownBy(models)) continue;
    place.panel.setAttribute("aria-busy", "true");
    told(place, make("p", { class: "soft" }, "Being computed \u2026"));
  }
}

let waiting = 0;

/** The result is drawn first: the panels come with the next frame. */
function soon() {
  cancelAnimationFrame(waiting);
  waiting = requestAnimationFrame(() => setTimeout(refresh));
}

const recordFor = (model) => chosenRecord ?? model.record;

async function refresh() {
  const models = shownModels();
  const now = ++turn;
  if (chosenRecord && !recordOf(chosenRecord)) chosenRecord = null;
  empty.hidden = models.length > 0;
  grid.hidden = !models.length;
  if (!models.length) {
    fill(head);
    return;
  }
  awaitPanels(models);
  await attempt(async () => {
    const details = await Promise.all(models.map((model) => detailOf(model.id)));
    if (now !== turn) return;
    fillBeside(models, details);
    await choosePair(models);
    if (now !== turn) return;
    if (chosenRecord && !suits(chosenRecord)) chosenRecord = null;
    fillHead(models);
    awaitPanels(models);
    for (const [name, , drawing] of PANELS) {
      const place = cards.get(name);
      const found = await Promise.all(models.map((model) =>
        panelOf(model.id, name, recordFor(model))));
      if (now !== turn) return;
      told(place);
      await drawing(place, models.map((model, at) => ({ model, data: found[at] })));
      place.shows = shownBy(models);
      place.panel.removeAttribute("aria-busy");
    }
  });
}

// ---------------------------------------------------------------- what is shown
let pairs = [];

async function choosePair(models) {
  const found = await Promise.all(models.map((model) =>
    panelOf(model.id, "bode", model.record)));
  pairs = found.flatMap((one) => one.pairs.map(({ output, input }) => ({ output, input })));
  if (!pairs.some((one) => one.output === state.output)) state.output = pairs[0]?.output ?? null;
  const inputs = pairs.filter((one) => one.output === state.output);
  if (!inputs.some((one) => one.input === state.input)) state.input = inputs[0]?.input ?? null;
}

/** Whether a record has the channels of the ticked models; which it lacks is said. */
function suits(id) {
  const record = recordOf(id);
  const own = new Set(record.channels.map((one) => one.name));
  const lacking = distinct(pairs.flatMap(({ output, input }) => [input, output]))
    .filter((name) => !own.has(name));
  if (lacking.length) {
    warn(`${record.name} has no channel ${lacking.join(", ")}, which the ticked models describe; `
      + "choose a record with the same channels.");
  }
  return !lacking.length;
}

const distinct = (names) => [...new Set(names)];

function fillHead(models) {
  const selects = [["output", distinct(pairs.map((one) => one.output))],
    ["input", distinct(pairs.map((one) => one.input))]];
  const legend = models.map((model) => {
    const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
    swatch.style.background = modelColour(model);
    return make("span", { class: "key" }, swatch, model.name);
  });
  const measured = make("span", { class: "swatch", "aria-hidden": "true" });
  measured.style.background = colour("measured");
  fill(head,
    ...selects.map(([name, names]) => make("label", {}, `${name} `,
      choice(names, state[name], (value) => { state[name] = value; tell("pair", "result"); },
        { "data-key": `pair ${name}` }))),
    make("label", {}, "on record ",
      choice([["", "each its own"], ...state.session.records.map(({ id, name }) => [id, name])],
        chosenRecord ?? "", (id) => { chosenRecord = id || null; refresh(); },
        { "data-key": "on record" })),
    make("span", { class: "legend" },
      make("span", { class: "key" }, measured, "measured"), legend));
}

const isChosen = (one) => one.output === state.output && one.input === state.input;
const pairOf = (data) => data.pairs.find(isChosen) ?? null;
const outputOf = (data) => data.outputs.find((one) => one.name === state.output) ?? null;
const styled = (model, more = {}) => ({ ...more, name: safe(model.name),
  line: { dash: modelDash(model), ...more.line } });

function told(place, ...lines) {
  fill(place.told, lines.flat().filter(Boolean));
}

/** The layout of a picture whose place keeps its height when the window changes. */
function sized(place, height, more = {}) {
  place.plot.style.height = `${height}px`;
  return layout({ height, ...more });
}

// ---------------------------------------------------------------- over time
async function drawFit(place, all) {
  const rows = all.map(({ model, data }) => ({ model, one: outputOf(data) })).filter(({ one }) => one);
  if (!rows.length) return nothing(place);
  const seen = new Set();
  const traces = rows.flatMap(({ model, one }) => {
    const record = recordFor(model);
    const measured = seen.has(record) ? [] : [line(one.time, one.measured, colour("measured"),
      { name: "measured", line: { width: 1 } })];
    seen.add(record);
    return [...measured, ...band(one.time, one.low, one.high, modelColour(model)),
      line(one.time, one.model, modelColour(model), styled(model))];
  });
  const made = sized(place, HEIGHT + 120);
  made.xaxis = axis("time [s]");
  made.yaxis = axis(withUnit(brief(rows[0].one.name, fitting(HEIGHT)), rows[0].one.unit));
  await draw(place.plot, traces, made);
  link(place.plot, ["residual"]);
}

async function drawResidual(place, all) {
  const rows = all.map(({ model, data }) => ({ model, one: outputOf(data) })).filter(({ one }) => one);
  if (!rows.length) return nothing(place);
  const traces = rows.flatMap(({ model, one }) => [
    line(one.time, one.residual, modelColour(model), { name: safe(model.name), line: { width: 1 } }),
    dots(one.lags, one.autocorrelation, modelColour(model),
      { xaxis: "x2", yaxis: "y2", name: safe(`${model.name}: with itself`) }),
    ...crossed(model, one)]);
  const made = sized(place, HEIGHT, { shapes: limits(rows) });
  const unit = unitOf(all[0].data, all[0].model);
  made.xaxis = axis("time [s]", { domain: [0, 1], anchor: "y" });
  made.yaxis = axis(withUnit("residual", unit), { domain: [0.6, 1], nticks: 5 });
  made.xaxis2 = axis("lag [s]", { domain: [0, 1], anchor: "y2" });
  made.yaxis2 = axis("correlation [-]", { domain: [0, 0.36], nticks: 4, range: [-1, 1],
    autorange: true });
  await draw(place.plot, traces, made);
  link(place.plot, ["fit"]);
  const { stretch } = rows[0].one;
  told(place, rows.length > 1 ? testsOf(rows) : tests(rows[0].model, rows[0].one),
    stretch ? make("p", { class: "soft" }, `Tested on ${stretch}.`) : null);
}

const unitOf = (data) =>
  data.outputs.find((one) => one.name === state.output)?.unit
  ?? recordOf()?.channels.find((one) => one.name === state.output)?.unit ?? "";

function crossed(model, one) {
  const cross = one.crosscorrelation?.[state.input];
  if (!cross) return [];
  return [line(one.lags, cross, modelColour(model), { xaxis: "x2", yaxis: "y2",
    name: safe(`${model.name}: with ${state.input}`), line: { width: 1, dash: "dot" } })];
}

function limits(rows) {
  const limit = Math.max(...rows.map(({ one }) => one.correlation_limit ?? 0));
  return [-limit, limit].map((at) => ({ type: "line", xref: "x2 domain", yref: "y2", x0: 0, x1: 1,
    y0: at, y1: at, line: { color: colour("soft"), width: 1, dash: "dash" } }));
}

function tests(model, one) {
  return make("ul", { class: "tests", "aria-label": `Tests of ${model.name}` },
    (one.tests ?? []).map((test) => make("li", { class: test.passed ? "passed" : "failed" },
      make("strong", {}, test.passed ? "passed" : "failed"), ` ${test.text || test.name}`)));
}

/** "p = 0.71" in a column of such numbers. */
const bare = (text) => text.replace(/^p (= )?/, "").replace(/ /g, "\u00a0");

/** Tests of several models side by side, a failed one in words. */
function testsOf(rows) {
  const parts = ({ text, name }) => {
    const at = text ? text.lastIndexOf(": ") : -1;
    return at < 0 ? [text || name, ""] : [text.slice(0, at), text.slice(at + 2)];
  };
  const asked = distinct(rows.flatMap(({ one }) => one.tests.map((test) => parts(test)[0])));
  const cell = ({ one }, text) => {
    const test = one.tests.find((other) => parts(other)[0] === text);
    if (!test) return "\u2013";
    return test.passed ? bare(parts(test)[1])
      : make("span", { class: "failed" }, make("strong", {}, "failed"), ` ${bare(parts(test)[1])}`);
  };
  return table(["test of the residual, p", ...rows.map(({ model }) => model.name)],
    asked.map((text) => [text, ...rows.map((row) => cell(row, text))]),
    { "aria-label": "Tests of the residuals", class: "coefficients" });
}

/** Zooming one picture over time zooms the others. */
function link(plot, names) {
  plot.removeAllListeners?.("plotly_relayout");
  plot.on("plotly_relayout", (event) => {
    const zoomed = "xaxis.range[0]" in event;
    if (!zoomed && !event["xaxis.autorange"]) return;
    const change = zoomed
      ? { "xaxis.range": [event["xaxis.range[0]"], event["xaxis.range[1]"]], "xaxis.autorange": false }
      : { "xaxis.autorange": true };
    for (const name of names) {
      const { plot: other } = cards.get(name);
      const now = other.layout?.xaxis;
      if (!now || (zoomed && String(now.range) === String(change["xaxis.range"]))) continue;
      if (!zoomed && now.autorange) continue;
      chart.relayout(other, change);
    }
  });
}

// ---------------------------------------------------------------- over frequency
async function drawBode(place, all) {
  const rows = all.map(({ model, data }) => ({ model, one: pairOf(data) })).filter(({ one }) => one);
  if (!rows.length) return nothing(place);
  const measured = rows.map(({ one }) => one.measured).find((one) => one?.frequency?.length);
  const traces = [...measuredResponse(measured), ...rows.flatMap(({ model, one }) => {
    const tone = modelColour(model);
    const phase = { yaxis: "y2" };
    return [...band(one.frequency, one.magnitude_low, one.magnitude_high, tone),
      line(one.frequency, one.magnitude_db, tone, styled(model)),
      ...band(one.frequency, one.phase_low, one.phase_high, tone, phase),
      line(one.frequency, one.phase_deg, tone, styled(model, phase))];
  })];
  const rest = measured ? { magnitude: [0.62, 1], phase: [0.26, 0.57] }
    : { magnitude: [0.54, 1], phase: [0, 0.46] };
  const made = sized(place, HEIGHT + 60);
  made.xaxis = axis("frequency [rad/s]", { type: "log", anchor: measured ? "y3" : "y2",
    dtick: decades(rows), exponentformat: "none" });
  made.yaxis = axis("magnitude [dB]", { domain: rest.magnitude, nticks: 5 });
  made.yaxis2 = axis("phase [deg]", { domain: rest.phase, nticks: 5 });
  if (measured) {
    made.yaxis3 = axis("coherence [-]", { domain: [0, 0.2], range: [0, 1.05], tickvals: [0, 0.5, 1] });
  }
  await draw(place.plot, traces, made);
  const unit = perUnit(...unitsOf(rows[0].model));
  told(place, hasUnit(unit) ? make("p", { class: "soft" }, `0 dB is 1 ${unit}`) : []);
}

const decades = (rows) => {
  const { frequency } = rows[0].one;
  return Math.log10(frequency.at(-1) / frequency[0]) > 1 ? 1 : "D2";
};

function measuredResponse(measured) {
  if (!measured) return [];
  const tone = colour("measured");
  const { frequency, magnitude_db: magnitude, phase_deg: phase, coherence } = measured;
  const more = { name: "measured", marker: { size: 3.5 } };
  return [dots(frequency, magnitude, tone, more),
    dots(frequency, phase, tone, { ...more, yaxis: "y2" }),
    line(frequency, coherence, tone, { name: "coherence", yaxis: "y3", line: { width: 1 } })];
}

// ---------------------------------------------------------------- step, poles
async function drawStep(place, all) {
  const rows = all.map(({ model, data }) => ({ model, one: pairOf(data) })).filter(({ one }) => one);
  if (!rows.length) return nothing(place);
  const traces = rows.flatMap(({ model, one }) => [
    ...band(one.time, one.low, one.high, modelColour(model)),
    line(one.time, one.value, modelColour(model), styled(model))]);
  const made = sized(place, HEIGHT + 60);
  made.xaxis = axis("time [s]");
  made.yaxis = axis(ratioOf(brief(state.output, fitting(HEIGHT)), ...unitsOf(rows[0].model)));
  await draw(place.plot, traces, made);
}

/** Units of the output and the input that are shown. */
function unitsOf(model) {
  const record = recordOf(model.record);
  return [state.output, state.input].map((name) =>
    record?.channels.find((one) => one.name === name)?.unit);
}

async function drawPoles(place, all) {
  const traces = all.flatMap(({ model, data }) => [
    roots(data.poles, model, "x-thin", "pole"),
    roots(zerosOf(data), model, "circle-open", "zero")]);
  const made = sized(place, HEIGHT);
  const zero = { zeroline: true, zerolinecolor: colour("soft") };
  made.xaxis = axis("real part [1/s]", { ...zero, range: around(traces.flatMap(({ x }) => x)) });
  made.yaxis = axis("imaginary part [rad/s]", { ...zero, range: around(traces.flatMap(({ y }) => y)) });
  await draw(place.plot, traces, made);
  told(place, all.map(({ model, data }) => make("p", { class: "soft" },
    `${model.name}: ${modes(data.poles)}`)));
}

/** A range that holds all values and zero, with room around them. */
function around(values) {
  const low = Math.min(0, ...values);
  const high = Math.max(0, ...values);
  const room = 0.12 * (high - low) || 1;
  return [low - room, high + room];
}

const zerosOf = (data) => pairOf({ pairs: data.pairs ?? [] })?.zeros ?? data.zeros ?? [];

const roots = (list, model, symbol, kind) =>
  dots(list.map((one) => one.re), list.map((one) => one.im), modelColour(model), {
    name: safe(`${model.name}: ${kind}`),
    marker: { size: 10, symbol, line: { width: 2, color: modelColour(model) } } });

function modes(poles) {
  return poles.filter((one) => one.im >= 0).map((one) => {
    const frequency = Number(one.frequency.toPrecision(4));
    return one.im > 0
      ? `${frequency} rad/s with damping ${Number(one.damping.toPrecision(3))}`
      : `real pole, ${Number((1 / one.frequency).toPrecision(3))} s`;
  }).join("; ") || "no poles";
}

function nothing(place) {
  erase(place.plot);
  place.plot.style.height = "";
  told(place, make("p", { class: "soft" }, "None of the ticked models has this output and input."));
}

// ---------------------------------------------------------------- side by side
let compared = null;

function fillBeside(models, details) {
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
