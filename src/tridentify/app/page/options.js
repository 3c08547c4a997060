// Under the record: what is asked of the estimate, made from the server's list of options.

import * as act from "./actions.js";
import { get } from "./api.js";
import { button, byId, choice, fill, make } from "./dom.js";
import { listen, recordOf, remember, state, tell } from "./state.js";

const FIRST = "Model";

let form, runner;

export async function startOptions() {
  runner = make("div", { class: "row runner" });
  form = make("form", { class: "options", on: {
    submit: (event) => event.preventDefault(),
    keydown: (event) => {
      if (event.key !== "Enter" || event.target.tagName !== "INPUT") return;
      event.preventDefault();
      event.target.dispatchEvent(new Event("change"));
      act.estimate();
    },
  } });
  byId("options").append(make("h2", {}, "Estimate"), runner, form);
  listen(["job", "record", "online"], fillRunner);
  listen("chosen", () => {
    fillForm();
    fillRunner();
  });
  fillRunner();
  await act.attempt(async () => {
    state.options = await get("/options");
    const names = new Set(state.options.map((option) => option.name));
    state.chosen = Object.fromEntries(
      Object.entries(state.chosen).filter(([name]) => names.has(name)));
    fillForm();
  });
}

// ---------------------------------------------------------------- run
function fillRunner() {
  const { job } = state;
  if (!job) {
    return fill(runner,
      button("Estimate", () => act.estimate(), { class: "primary", "data-key": "run",
        disabled: !recordOf() || state.gone }),
      make("label", { class: "box", title: "New models are shown beside those that are ticked" },
        make("input", { type: "checkbox", checked: Boolean(state.keep), "data-key": "keep",
          on: { change: (event) => { state.keep = event.target.checked; } } }),
        "beside the ticked models"),
      button("Options as they come", reset, { class: "link", "data-key": "reset",
        disabled: !Object.keys(state.chosen).length }));
  }
  const share = Math.round(100 * (job.fraction ?? 0));
  const bar = runner.querySelector("progress");
  if (bar) {
    bar.value = job.fraction ?? 0;
    runner.querySelector(".share").textContent = progress(job, share);
    return;
  }
  fill(runner, button("Cancel", () => act.cancel(), { "data-key": "run" }),
    make("progress", { max: "1", value: job.fraction ?? 0, "aria-label": "Progress of the estimate" }),
    make("span", { class: "share soft" }, progress(job, share)));
}

const progress = (job, share) => [`${share} %`, job.message].filter(Boolean).join(", ");

function reset() {
  state.chosen = {};
  remember({ chosen: {} });
  tell("chosen");
}

// ---------------------------------------------------------------- form
function fillForm() {
  const groups = new Map();
  for (const option of state.options) {
    const name = option.group ?? FIRST;
    groups.set(name, [...(groups.get(name) ?? []), option]);
  }
  const before = new Map([...form.querySelectorAll("details")].map((one) =>
    [one.dataset.group, one.open])); // what was opened stays open
  fill(form, [...groups].map(([name, options], number) =>
    make("details", { class: "fieldset", "data-group": name,
      open: options.some(isChanged) || (before.get(name) ?? number === 0) },
      make("summary", {}, name),
      make("div", { class: "fields" }, options.map(field)))));
}

const valueOf = (option) => state.chosen[option.name] ?? option.default;
const isChanged = (option) => option.name in state.chosen;

function set(option, value) {
  if (same(value, option.default)) delete state.chosen[option.name];
  else state.chosen[option.name] = value;
  remember({ chosen: state.chosen });
  tell("options");
  fillRunner();
  form.querySelector(`[data-option="${CSS.escape(option.name)}"]`)
    ?.classList.toggle("changed", isChanged(option));
}

const same = (one, other) => String(one ?? "") === String(other ?? "");

function field(option) {
  const id = `option-${option.name}`;
  return make("div", { class: `field ${option.type} ${isChanged(option) ? "changed" : ""}`,
    "data-option": option.name },
  make("label", { for: id, title: option.help ?? "" }, option.label ?? option.name),
  CONTROLS[option.type](option, { id, title: option.help ?? "", "data-key": id,
    "aria-description": option.help ?? "" }));
}

const typed = (kind, read) => (option, attributes) =>
  make("input", { ...attributes, type: kind, step: "any", value: valueOf(option) ?? "",
    placeholder: option.default ?? option.placeholder ?? "", autocomplete: "off",
    spellcheck: "false", on: { change: (event) => set(option, read(event.target.value, option)) } });

const number = (text, option) => (text.trim() === "" ? option.default : Number(text));

const CONTROLS = {
  boolean: (option, attributes) => make("input", { ...attributes, type: "checkbox",
    checked: Boolean(valueOf(option)),
    on: { change: (event) => set(option, event.target.checked) } }),
  choice: (option, attributes) => choice(option.choices.map(asPair), valueOf(option),
    (text) => set(option, original(option, text)), attributes),
  integer: typed("number", number),
  number: typed("number", number),
  text: typed("text", (text) => text.trim()),
};

const asPair = (one) => (one === null ? ["", "none"] : one);
const original = (option, text) =>
  option.choices.map((one) => (Array.isArray(one) ? one[0] : one))
    .find((one) => String(one ?? "") === text) ?? text;
