// What the record itself says, before anything is estimated from it.

import { attempt, obstacle } from "./actions.js";
import { get } from "./api.js";
import { button, fill, make } from "./dom.js";
import { findingList } from "./findings.js";
import { note, warn } from "./messages.js";

/** Asks what the record is good for and writes the answer into `place`. */
export async function advise(record, place) {
  const problem = obstacle(record);
  if (problem) return warn(problem, "estimate");
  note("Looking at the record ...");
  await attempt(async () => {
    const { facts, notes, findings } = await get(`/records/${record.id}/advice`);
    note("");
    fill(place, make("div", { class: "row" }, make("h3", {}, "What the record says"),
      button("\u00d7", () => fill(place), { class: "quiet", "aria-label": "Close the advice" })),
    findingList(findings) ?? make("p", {}, "Nothing stands in the way of an estimate."),
    make("div", { class: "scroll" }, make("table", { "aria-label": "What the record shows" },
      make("tbody", {}, facts.map((pair) => make("tr", {},
        pair.map((text, column) => make("td", { class: column ? null : "text" }, text))))))),
    ...notes.map((text) => make("p", { class: "soft" }, text)));
  });
}
