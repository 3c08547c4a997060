// One sentence for everything that went wrong or was done.

import { Refusal } from "./api.js";
import { button, byId, make } from "./dom.js";

const TOLD_FOR = 4000; // milliseconds
const NO_FILE = "Found no file "; // how the server begins where a record's file is lost
const PASSING = ["error", "estimate", "range"]; // kinds that end with the next success

let clock = 0;

/** A short note that goes away by itself. */
export function note(text) {
  const told = byId("told");
  told.textContent = text;
  clearTimeout(clock);
  clock = setTimeout(() => { told.textContent = ""; }, TOLD_FOR);
}

/** A message that stays until it is closed; one of a `kind` at a time, one of what passes. */
export function warn(text, kind = "error", ...buttons) {
  clear(kind);
  if (PASSING.includes(kind)) settled();
  const row = make("div", { class: `message ${kind}`, "data-kind": kind, role: "alert" },
    make("div", { class: "said" }, text.split("\n").map((line) => make("p", {}, line))), buttons,
    button("\u00d7", () => close(row), { "aria-label": "Close this message" }));
  byId("messages").append(row);
  while (byId("messages").children.length > 3) byId("messages").firstChild.remove();
}

/** Takes a message away; the tab key goes on from the record. */
function close(row) {
  row.remove();
  byId("record").focus({ preventScroll: true });
}

export function clear(kind) {
  for (const row of rowsOf(kind)) row.remove();
}

const rowsOf = (kind) => byId("messages").querySelectorAll(`[data-kind="${CSS.escape(kind)}"]`);

/** What was refused before an action that succeeded, or of another record, is no longer said. */
export function settled(...others) {
  for (const kind of [...PASSING, ...others]) clear(kind);
}

/** What stands there now and ends with the success of what is begun now: what follows stays. */
export function passing() {
  const rows = PASSING.flatMap((kind) => [...rowsOf(kind)]);
  return () => rows.forEach((row) => row.remove());
}

const kindOf = ({ code, message }) => {
  if (code === "gone") return "gone";
  return message.startsWith(NO_FILE) ? "missing" : "error"; // a lost file is said once
};

/** Says what `error` says; what was only interrupted is not an error. */
export function explain(error) {
  if (error.name === "AbortError") return;
  if (error instanceof Refusal) {
    const kind = kindOf(error);
    if (kind !== "missing" || !rowsOf(kind).length) warn(error.sentence, kind);
  } else {
    warn(`The page met a fault of its own: ${error.message}. Reload it; the session is kept.`);
  }
}
