// The picture of the record: a row for each channel, its pieces behind them.

import { axis, colour, draw, faint, FIXED, layout, line, safe } from "./charts.js";
import { brief, withUnit } from "./numbers.js";
import { pieces } from "./ranges.js";
import { channelOf } from "./state.js";
import { extent } from "./view.js";

export const LEFT = 62; // pixels of the numbers beside the channels
export const RIGHT = 10;
const TOP = 6;
const BOTTOM = 38;
const ROW = 112; // pixels of one channel
const HIGHEST = 620; // pixels of all channels, as long as each keeps LOWEST
const LOWEST = 64;
const MOST = 48; // letters of a name above its channel
const GAP = 0.16; // of a row, for the channel's name
const COLOURS = { identify: "identify", validate: "validate", bad: "bad" };

const heightOf = (rows) =>
  Math.max(rows * LOWEST, Math.min(rows * ROW, HIGHEST)) + TOP + BOTTOM;

/** Draws the channels of `series` and the pieces of the record into `plot`. */
export function drawRecord(plot, record, series) {
  const rows = series.names.filter((name) => series.channels[name]);
  const height = heightOf(rows.length);
  plot.style.height = `${height}px`;
  draw(plot, rows.map((name, row) => trace(record, series, name, row)),
    shape(record, rows, height), FIXED);
}

const axisName = (row) => `y${row ? row + 1 : ""}`;

function trace(record, series, name, row) {
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
