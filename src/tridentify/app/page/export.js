// The menu of files that a model leaves the workbench as.

import { attempt } from "./actions.js";
import { download } from "./api.js";
import { byId, button, fill, make } from "./dom.js";
import { note } from "./messages.js";
import { isDone, listen, modelOf } from "./state.js";

const KINDS = [["json", "Model (JSON)"], ["matlab", "MATLAB"], ["c", "C header"],
  ["control", "python-control"], ["report", "Report (HTML)"], ["figure", "Figure"],
  ["table", "Table of coefficients"]];

let menu, list, opener;

export function startExport() {
  menu = byId("export");
  list = make("div", { class: "choices", id: "kinds", hidden: true });
  opener = button("Export", toggle, { id: "export-button", "aria-expanded": "false",
    "aria-controls": "kinds" });
  menu.append(opener, list);
  menu.addEventListener("keydown", (event) => {
    if (event.key === "Escape") close(true);
  });
  menu.addEventListener("focusout", (event) => {
    if (!menu.contains(event.relatedTarget)) close(false);
  });
  listen(["models", "session"], refresh);
  refresh();
}

function refresh() {
  const model = modelOf();
  opener.disabled = !model || !isDone(model);
  opener.title = model ? `Files of ${model.name}` : "Estimate a model first";
}

function toggle() {
  if (!list.hidden) return close(true);
  const model = modelOf();
  fill(list, make("p", { class: "soft" }, model.name),
    KINDS.map(([kind, text]) => button(text, () => save(model, kind))));
  list.hidden = false;
  opener.setAttribute("aria-expanded", "true");
  list.querySelector("button").focus();
}

function close(back) {
  list.hidden = true;
  opener.setAttribute("aria-expanded", "false");
  if (back) opener.focus();
}

async function save(model, kind) {
  close(true);
  await attempt(async () => {
    const { name, blob } = await download(`/models/${model.id}/export/${kind}`);
    const address = URL.createObjectURL(blob);
    const anchor = make("a", { href: address, download: name });
    document.body.append(anchor);
    anchor.click();
    anchor.remove();
    setTimeout(() => URL.revokeObjectURL(address), 10_000);
    note(`${name} saved`);
  });
}
