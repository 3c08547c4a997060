// Pictures over time: measured against model, and the residual with its tests.

import { axis, band, colour, dots, draw, fitting, line, modelColour, relayout, safe } from "./charts.js";
import { make, table } from "./dom.js";
import { brief, withUnit } from "./numbers.js";
import { distinct, having, HEIGHT, nothing, outputOf, recordFor, sized, styled, told }
  from "./panel_parts.js";
import { recordOf, state } from "./state.js";

/** Measured against model, of all models on one record. */
export async function drawFit(place, all) {
  const rows = having(all, outputOf);
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
  link(place.plot);
}

/** What the models leave, its correlations and tests. */
export async function drawResidual(place, all) {
  const rows = having(all, outputOf);
  if (!rows.length) return nothing(place);
  const traces = rows.flatMap(({ model, one }) => [
    line(one.time, one.residual, modelColour(model), { name: safe(model.name), line: { width: 1 } }),
    dots(one.lags, one.autocorrelation, modelColour(model),
      { xaxis: "x2", yaxis: "y2", name: safe(`${model.name}: with itself`) }),
    ...crossed(model, one)]);
  const made = sized(place, HEIGHT, { shapes: limits(rows) });
  const unit = unitOf(all[0].data);
  made.xaxis = axis("time [s]", { domain: [0, 1], anchor: "y" });
  made.yaxis = axis(withUnit("residual", unit), { domain: [0.6, 1], nticks: 5 });
  made.xaxis2 = axis("lag [s]", { domain: [0, 1], anchor: "y2" });
  made.yaxis2 = axis("correlation [-]", { domain: [0, 0.36], nticks: 4, range: [-1, 1],
    autorange: true });
  await draw(place.plot, traces, made);
  link(place.plot);
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

const drawn = new Set(); // pictures over time

/** Zooming one picture over time zooms the others. */
function link(plot) {
  drawn.add(plot);
  plot.removeAllListeners?.("plotly_relayout");
  plot.on("plotly_relayout", (event) => {
    const zoomed = "xaxis.range[0]" in event;
    if (!zoomed && !event["xaxis.autorange"]) return;
    const change = zoomed
      ? { "xaxis.range": [event["xaxis.range[0]"], event["xaxis.range[1]"]], "xaxis.autorange": false }
      : { "xaxis.autorange": true };
    for (const other of drawn) {
      const now = other === plot ? null : other.layout?.xaxis;
      if (!now || (zoomed && String(now.range) === String(change["xaxis.range"]))) continue;
      if (!zoomed && now.autorange) continue;
      relayout(other, change);
    }
  });
}
