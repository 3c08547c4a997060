// Left: the records with their channels, and the models.

import * as act from "./actions.js";
import { attempt } from "./actions.js";
import { get } from "./api.js";
import { modelColour } from "./charts.js";
import { button, byId, choice, fill, make } from "./dom.js";
import { warn } from "./messages.js";
import { count, percent, plain, seconds, withUnit } from "./numbers.js";
import { isDone, listen, state } from "./state.js";

const ROLES = [["input", "input"], ["output", "output"], ["reference", "reference"],
  ["unused", "unused"]];
const PLACES = { input: "inputs", output: "outputs", reference: "references" };
const KINDS = ".csv,.txt,.tsv,.dat,.asc,.xlsx,.parquet,.feather,.arrow,.mat,.ulg,.mf4,.mdf,.npz,.npy";

let files = [];

export function startTray() {
  const records = make("div", { class: "records" });
  const models = make("div", { class: "models" });
  byId("tray").append(
    make("h2", {}, "Records"), adder(), folderFiles(), records,
    make("h2", {}, "Models"), models);
  listen(["session", "records"], () => fillList(records, recordCards(), state.record));
  listen(["session", "models", "theme"], () => fillList(models, modelCards(), state.model));
  const room = new ResizeObserver(() => {
    bring(records, state.record);
    bring(models, state.model);
  });
  for (const place of [byId("tray"), records, models]) room.observe(place);
  listen(["session"], () => { if (!files.length) refreshFiles(); });
  addEventListener("focus", refreshFiles);
  dropAnywhere();
}

function fillList(place, cards, current) {
  const before = place.scrollTop;
  fill(place, cards);
  place.scrollTop = before;
  bring(place, current);
}

/** Brings the current card into sight where it is another one, or it or its room is of another height. */
function bring(place, current) {
  const card = place.querySelector(".current");
  const now = [current, card?.offsetHeight, place.scrollHeight, place.clientHeight].join(" ");
  if (!card || place.dataset.current === now) return;
  place.dataset.current = now;
  const beyond = card.offsetTop + card.offsetHeight - place.clientHeight;
  place.scrollTop = Math.min(card.offsetTop, Math.max(place.scrollTop, beyond));
}

// ---------------------------------------------------------------- opening
function adder() {
  const input = make("input", { type: "file", multiple: true, accept: KINDS, id: "chooser",
    class: "offscreen", tabindex: "-1", "aria-hidden": "true",
    on: { change: () => { take(input.files); input.value = ""; } } });
  return make("div", { class: "adder" },
    button("Open files \u2026", () => input.click(), { class: "primary" }), input,
    make("p", { class: "soft" }, "or drop them on the page"),
    make("label", { class: "soft step" }, "no time in the file: one sample every ",
      make("span", {}, make("input", { type: "text", id: "step", inputmode: "decimal", size: "5",
        "aria-label": "Seconds between the samples of files without a column of time" }), " s")));
}

/** Calls `open` with the seconds between samples, null where none are given. */
function withStep(open) {
  const text = byId("step").value.trim();
  const given = text ? Number(text.replace(",", ".")) : null;
  if (given === null || (given > 0 && given < Infinity)) return open(given);
  return warn(`Found ${text} as the seconds between samples; give a number above zero such as 0.02, `
    + "or leave the field empty.");
}

function take(list) {
  const files = [...list];
  if (files.length) withStep((step) => act.uploadFiles(files, step));
}

function dropAnywhere() {
  const over = (on) => document.body.classList.toggle("dropping", on);
  addEventListener("dragover", (event) => {
    if (![...event.dataTransfer.types].includes("Files")) return;
    event.preventDefault();
    over(true);
  });
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) over(false); });
  addEventListener("drop", (event) => {
    event.preventDefault();
    over(false);
    take(event.dataTransfer.files);
  });
}

function folderFiles() {
  const list = make("ul", { class: "files" });
  const box = make("details", { class: "folder", hidden: true },
    make("summary", {}, "Files of the folder"), list);
  box.addEventListener("toggle", () => { if (box.open) refreshFiles(); });
  folderFiles.show = () => {
    if (box.hidden && files.length) box.open = !state.session.records.length;
    box.hidden = !files.length;
    fill(list, files.map((file) => make("li", {},
      button(file.name, () => withStep((step) => act.openFile(file.name, step)),
        { class: "link", disabled: !file.readable, "data-key": `file ${file.name}`,
          title: file.readable ? `Open ${file.name}` : "Not a format that is read" }),
      make("span", { class: "soft size" }, ` ${size(file.bytes)}`))));
  };
  return box;
}

const size = (bytes) =>
  bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`;

async function refreshFiles() {
  if (state.session.folder === null) return;
  files = await get("/files").catch(() => files);
  folderFiles.show();
}

// ---------------------------------------------------------------- records
function recordCards() {
  const { records } = state.session;
  if (!records.length) return [make("p", { class: "soft" }, "No record is open yet.")];
  return records.map(recordCard);
}

function recordCard(record) {
  const current = record.id === state.record;
  return make("article", { class: `card record ${current ? "current" : ""}` },
    make("div", { class: "row" },
      button(record.name, () => act.lookAt(record.id), { class: "name",
        "aria-pressed": String(current), "data-key": `record ${record.id}` }),
      button("\u00d7", () => act.dropRecord(record.id), { class: "quiet",
        "aria-label": `Remove ${record.name} from the session`, "data-key": `drop ${record.id}` })),
    make("p", { class: "soft" }, facts(record)),
    record.missing_file ? make("p", { class: "bad" }, "its file is gone") : null,
    record.changed_file ? changedFile(record) : null,
    current ? [channels(record), exchanged(record)] : null);
}

/** Said where what moved by itself is used as output, and what answered it as input. */
function exchanged(record) {
  const taken = (guess, place) => record.channels.map(({ name, guess: own }) => own === guess && name)
    .filter((name) => name && record[place].includes(name));
  const [moved, answered] = [taken("input", "outputs"), taken("output", "inputs")];
  if (!moved.length || !answered.length) return null;
  return make("p", { class: "bad" }, `By name and movement ${moved.join(", ")} was moved and `
    + `${answered.join(", ")} answered; here it is the other way round: perhaps they are exchanged.`);
}

const changedFile = ({ id, changed_file: text }) => make("div", { class: "row changed" },
  make("p", { class: "bad" }, text),
  button("\u00d7", () => act.fileSeen(id), { class: "quiet",
    "aria-label": "It is known that the file was changed", "data-key": `changed ${id}` }));

const facts = (record) => [
  count(record.n_samples, "sample"), seconds(record.duration),
  record.uniform === false ? "uneven time" : `every ${seconds(record.dt)}`].join(", ");

function channels(record) {
  return make("div", { class: "all" }, make("table", { class: "channels", "aria-label": `Channels of ${record.name}` },
    make("thead", { class: "offscreen" }, make("tr", {},
      make("th", {}, "channel"), make("th", {}, "used as"))),
    make("tbody", {}, record.channels.map((channel) => make("tr", {},
      make("td", { title: `${plain(channel.minimum)} to ${plain(channel.maximum)}, `
        + `mean ${plain(channel.mean)}` },
        withUnit(channel.name, channel.unit),
        channel.missing ? make("span", { class: "bad" }, ` ${channel.missing} missing`) : null),
      make("td", {}, choice(ROLES, roleOf(record, channel.name),
        (role) => setRole(record, channel.name, role),
        { "aria-label": `${channel.name} is used as`,
          "data-key": `role ${record.id} ${channel.name}` })))))));
}

const roleOf = (record, name) =>
  Object.keys(PLACES).find((role) => record[PLACES[role]].includes(name)) ?? "unused";

function setRole(record, name, role) {
  const changes = {};
  for (const [kind, place] of Object.entries(PLACES)) {
    const others = record[place].filter((one) => one !== name);
    const wanted = kind === role
      ? record.channels.map((one) => one.name).filter((one) => one === name || others.includes(one))
      : others;
    if (wanted.join("\n") !== record[place].join("\n")) changes[place] = wanted;
  }
  act.changeRecord(record.id, changes);
}

// ---------------------------------------------------------------- models
function modelCards() {
  const { models } = state.session;
  if (!models.length) return [make("p", { class: "soft" }, "Drag over the record to estimate one.")];
  return models.map(modelCard);
}

function modelCard(model) {
  const current = model.id === state.model;
  const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
  swatch.style.background = modelColour(model);
  const tick = make("input", { type: "checkbox", checked: model.shown !== false,
    disabled: !isDone(model), "data-key": `tick ${model.id}`,
    "aria-label": `Show ${model.name} in the panels`,
    on: { change: (event) => act.show(model.id, event.target.checked) } });
  return make("article", { class: `card model ${current ? "current" : ""}` },
    make("div", { class: "row" }, tick, swatch,
      button(model.name, () => act.choose(model.id), { class: "name",
        "aria-pressed": String(current), "data-key": `model ${model.id}` }),
      button("\u270e", () => rename(model), { class: "quiet",
        "aria-label": `Rename ${model.name}`, "data-key": `rename ${model.id}` }),
      button("\u00d7", () => act.dropModel(model.id), { class: "quiet",
        "aria-label": `Remove ${model.name}`, "data-key": `remove ${model.id}` })),
    make("p", { class: "soft" }, [model.structure,
      isDone(model) ? `fit ${(model.fit ?? []).map(percent).join(", ")}` : model.state]
      .filter(Boolean).join(", ")),
    model.older_file ? make("p", { class: "bad" }, "of older content of its file") : null);
}

function rename(model) {
  const old = byId("tray").querySelector(`[data-key="model ${CSS.escape(model.id)}"]`);
  const input = make("input", { type: "text", value: model.name, class: "name",
    "aria-label": "Name of the model", maxlength: "80", "data-key": `model ${model.id}` });
  const done = (keep) => {
    input.replaceWith(old);
    const name = input.value.trim();
    if (keep && name && name !== model.name) attempt(() => act.rename(model.id, name));
  };
  input.addEventListener("keydown", (event) => {
    if (event.key === "Enter") input.blur();
    if (event.key === "Escape") { input.value = model.name; input.blur(); }
  });
  input.addEventListener("blur", () => done(true), { once: true });
  old.replaceWith(input);
  input.select();
}
