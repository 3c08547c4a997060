// At the end: every action as lines of Python and of the command line, to copy.

import { detailOf } from "./details.js";
import { button, byId, fill, make } from "./dom.js";
import { note } from "./messages.js";
import { listen, modelOf, recordOf, state } from "./state.js";
import { attempt } from "./actions.js";

let body;

export function startLines() {
  body = make("div", {});
  byId("lines").append(make("details", {},
    make("summary", {}, "The same in Python and on the command line"), body));
  listen(["records", "record", "models", "result", "compared"], refresh);
}

async function refresh() {
  const model = modelOf();
  const record = recordOf();
  await attempt(async () => {
    const detail = model ? await detailOf(model.id).catch(() => null) : null;
    fill(body,
      record?.python ? pair(`Open ${record.name}`, record) : null,
      detail?.python ? pair(`Estimate ${model.name}`, detail) : null,
      detail?.export ? pair(`Export ${model.name}`, detail.export) : null,
      state.compared?.python ? pair("Compare", state.compared) : null);
  });
}

const pair = (title, { python, command_line: command }) => make("section", {},
  make("h3", {}, title), block(`Python: ${title}`, python),
  command ? block(`Command line: ${title}`, command) : null);

const block = (label, text) => make("div", { class: "code" },
  make("pre", { tabindex: "0", "aria-label": label }, text),
  button("Copy", () => copy(text), { "aria-label": `Copy ${label}`, "data-key": label }));

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    note("Copied");
  } catch {
    note("The browser does not let the page copy; mark the lines and copy them.");
  }
}
