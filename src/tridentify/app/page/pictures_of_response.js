// Pictures of the models alone: Bode diagram, step response, poles and zeros.

import { axis, band, colour, dots, draw, fitting, line, modelColour, safe } from "./charts.js";
import { make } from "./dom.js";
import { brief, hasUnit, perUnit, ratioOf } from "./numbers.js";
import { having, HEIGHT, nothing, pairOf, sized, styled, told, unitsOf } from "./panel_parts.js";
import { state } from "./state.js";

const ROOM = { magnitude: 30, phase: 180 }; // of a band beyond the curves, dB and degrees

/** Magnitude and phase with their bands, and what was measured with its coherence. */
export async function drawBode(place, all) {
  const rows = having(all, pairOf);
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
  const every = (...names) => [...rows.map(({ one }) => one), measured ?? {}]
    .flatMap((one) => names.flatMap((name) => one[name] ?? [])).filter(Number.isFinite);
  made.yaxis = axis("magnitude [dB]", { domain: rest.magnitude, nticks: 5,
    range: near(every("magnitude_db"), every("magnitude_low", "magnitude_high"), ROOM.magnitude) });
  made.yaxis2 = axis("phase [deg]", { domain: rest.phase, nticks: 5,
    range: near(every("phase_deg"), every("phase_low", "phase_high"), ROOM.phase) });
  if (measured) {
    made.yaxis3 = axis("coherence [-]", { domain: [0, 0.2], range: [0, 1.05], tickvals: [0, 0.5, 1] });
  }
  await draw(place.plot, traces, made);
  const unit = perUnit(...unitsOf(rows[0].model));
  told(place, hasUnit(unit) ? make("p", { class: "soft" }, `0 dB is 1 ${unit}`) : []);
}

/** A range that holds the curves, and as much of their bands as leaves room for them. */
function near(curves, bands, room) {
  if (!curves.length) return undefined;
  const [low, high] = [Math.min(...curves), Math.max(...curves)];
  const bottom = Math.max(Math.min(low, ...bands), low - room);
  const top = Math.min(Math.max(high, ...bands), high + room);
  const edge = 0.05 * (top - bottom) || 1;
  return [bottom - edge, top + edge];
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

/** Responses to a unit step. */
export async function drawStep(place, all) {
  const rows = having(all, pairOf);
  if (!rows.length) return nothing(place);
  const traces = rows.flatMap(({ model, one }) => [
    ...band(one.time, one.low, one.high, modelColour(model)),
    line(one.time, one.value, modelColour(model), styled(model))]);
  const made = sized(place, HEIGHT + 60);
  made.xaxis = axis("time [s]");
  made.yaxis = axis(ratioOf(brief(state.output, fitting(HEIGHT)), ...unitsOf(rows[0].model)));
  await draw(place.plot, traces, made);
}

/** Poles and zeros in the complex plane. */
export async function drawPoles(place, all) {
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
