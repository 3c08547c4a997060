// What the pictures have in common: colours of the theme, axes with units, lines of models.

/* global Plotly */

import { make } from "./dom.js";

const DASHES = ["solid", "dash", "dashdot", "dot"];
const COLOURS = 7;
const LETTER = 7.5; // pixels of a letter beside an axis
const UNIT = 8; // letters that are kept free for a unit
const PLAIN_UP_TO = 4; // powers of ten that an axis writes out
const FONT = "system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif";

export const CONFIG = { displayModeBar: false, displaylogo: false, responsive: true };
export const FIXED = { ...CONFIG, staticPlot: true };

/** The value of a colour of page.css, `ink` for `--ink`. */
export const colour = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export const modelColour = (model) => colour(`model-${(model.colour_index ?? 0) % COLOURS}`);
export const modelDash = (model) => DASHES[(model.colour_index ?? 0) % DASHES.length];

/** A name as plotly takes it: its markup is not ours. */
export const safe = (text) =>
  String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

/** `#rrggbb` with an opacity. */
export function faint(hex, opacity) {
  const parts = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  return `rgba(${parts.join(",")},${opacity})`;
}

/** Letters of a name that fit along an axis, beside its unit. */
export const fitting = (pixels) => Math.max(8, Math.floor(pixels / LETTER) - UNIT);

export function axis(title, more = {}) {
  const line = colour("line");
  return {
    title: { text: safe(title), standoff: 6, font: { size: 12 } }, automargin: true,
    gridcolor: line, zerolinecolor: line, linecolor: line, tickfont: { size: 11 },
    nticks: 7, exponentformat: "power", minexponent: PLAIN_UP_TO, ...more,
  };
}

export function layout(more = {}) {
  return {
    font: { family: FONT, size: 12, color: colour("ink") },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false,
    margin: { l: 56, r: 12, t: 8, b: 40 }, dragmode: "zoom", hovermode: "closest",
    hoverlabel: { font: { family: FONT, size: 12 } }, ...more,
  };
}

export const line = (x, y, colour, more = {}) => ({
  type: "scatter", mode: "lines", x, y, line: { color: colour, width: 1.6, ...more.line },
  hoverinfo: "x+y+name", ...without(more, "line"),
});

export const dots = (x, y, colour, more = {}) => ({
  type: "scatter", mode: "markers", x, y, marker: { color: colour, size: 4, ...more.marker },
  hoverinfo: "x+y+name", ...without(more, "marker"),
});

/** A band between two curves, in the faint colour of its model. */
export function band(x, low, high, colour, more = {}) {
  if (!low || !high) return [];
  const edge = { type: "scatter", mode: "lines", line: { width: 0 }, hoverinfo: "skip", ...more };
  return [
    { ...edge, x, y: low },
    { ...edge, x, y: high, fill: "tonexty", fillcolor: faint(colour, 0.18) },
  ];
}

function without(values, name) {
  const { [name]: _, ...rest } = values;
  return rest;
}

let ready = null;

/** The library of pictures: it is long, so the rest of the page comes before it. */
function library() {
  ready ??= new Promise((done, failed) => {
    const script = make("script", { src: "/vendor/plotly.min.js", on: { load: done,
      error: () => failed(new Error("the pictures' library could not be loaded")) } });
    requestAnimationFrame(() => setTimeout(() => document.head.append(script)));
  });
  return ready;
}

/** Draws into `node`, again and again into the same picture. */
export async function draw(node, traces, shape, config = CONFIG) {
  await library();
  if (!node.isConnected) return;
  await Plotly.react(node, traces, shape, config);
}

export function erase(node) {
  if (node.data) Plotly.purge(node);
}

export async function relayout(node, change) {
  await Plotly.relayout(node, change);
}
