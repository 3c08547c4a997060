// Below: linked panels of all ticked models, and their coefficients side by side.

import { attempt } from "./actions.js";
import { fillBeside, startBeside } from "./beside.js";
import { colour, modelColour } from "./charts.js";
import { detailOf, panelOf } from "./details.js";
import { byId, choice, fill, make } from "./dom.js";
import { choosePair, inputs, outputs, suits } from "./pair.js";
import { recordFor, shown, told } from "./panel_parts.js";
import { drawFit, drawResidual } from "./pictures_in_time.js";
import { drawBode, drawPoles, drawStep } from "./pictures_of_response.js";
import { listen, recordOf, shownModels, state, tell } from "./state.js";

const PANELS = [
  ["fit", "Fit", drawFit],
  ["residual", "Residual", drawResidual],
  ["bode", "Bode", drawBode],
  ["step", "Step response", drawStep],
  ["poles", "Poles and zeros", drawPoles],
];

const cards = new Map();
let head, empty, grid, turn = 0;

export function startPanels() {
  head = make("div", { class: "tools" });
  empty = make("p", { class: "soft" }, "Tick a model on the left to see it here; several are overlaid.");
  grid = make("div", { class: "grid" });
  for (const [name, title] of PANELS) grid.append(card(name, title));
  grid.append(startBeside());
  byId("panels").append(make("h2", {}, "Panels"), head, empty, grid);
  listen(["models", "theme", "result"], soon);
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

/** No picture, where the files of all models have other channels now. */
function bare() {
  fill(head);
  for (const { panel } of cards.values()) panel.removeAttribute("aria-busy");
}

let waiting = 0;

/** The result is drawn first: the panels come with the next frame. */
function soon() {
  cancelAnimationFrame(waiting);
  waiting = requestAnimationFrame(() => setTimeout(refresh));
}

async function refresh() {
  let models = shownModels();
  const now = ++turn;
  if (shown.record && !recordOf(shown.record)) shown.record = null;
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
    models = models.filter((model, at) => details[at].pictures !== false);
    grid.classList.toggle("bare", !models.length);
    if (!models.length) return bare();
    await choosePair(models);
    if (now !== turn) return;
    if (shown.record && !suits(shown.record)) shown.record = null;
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

function fillHead(models) {
  const selects = [["output", outputs()], ["input", inputs()]];
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
        shown.record ?? "", (id) => { shown.record = id || null; refresh(); },
        { "data-key": "on record" })),
    make("span", { class: "legend" },
      make("span", { class: "key" }, measured, "measured"), legend));
}
