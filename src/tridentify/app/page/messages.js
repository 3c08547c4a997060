// One sentence for everything that went wrong or was done.

import { Refusal } from "./api.js";
import { button, byId, make } from "./dom.js";

const TOLD_FOR = 4000; // milliseconds

let clock = 0;

/** A short note that goes away by itself. */
export function note(text) {
  const told = byId("told");
  told.textContent = text;
  clearTimeout(clock);
  clock = setTimeout(() => { told.textContent = ""; }, TOLD_FOR);
}

/** A message that stays until it is closed; one of a `kind` at a time. */
export function warn(text, kind = "error", ...buttons) {
  clear(kind);
  const row = make("div", { class: `message ${kind}`, "data-kind": kind, role: "alert" },
    make("p", {}, text), buttons,
    button("\u00d7", () => row.remove(), { "aria-label": "Close this message" }));
  byId("messages").append(row);
  while (byId("messages").children.length > 3) byId("messages").firstChild.remove();
}

export function clear(kind) {
  for (const row of byId("messages").querySelectorAll(`[data-kind="${CSS.escape(kind)}"]`)) {
    row.remove();
  }
}

/** Says what `error` says; what was only interrupted is not an error. */
export function explain(error) {
  if (error.name === "AbortError") return;
  if (error instanceof Refusal) warn(error.sentence, error.code === "gone" ? "gone" : "error");
  else {
    warn(`The page met a fault of its own: ${error.message}. Reload it; the session is kept.`);
  }
}
