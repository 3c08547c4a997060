// The informative pieces of a long record, each with its reason.

import * as act from "./actions.js";
import { get } from "./api.js";
import { button, fill, make } from "./dom.js";
import { note, warn } from "./messages.js";
import { count, plain } from "./numbers.js";
import { kept, pieces, store } from "./ranges.js";
import { recordOf } from "./state.js";
import { look } from "./view.js";

let manoeuvres = null; // { of, found }: id of the record, and what was found in it

/** Asks for the informative pieces of the record and lists them in `offers`. */
export async function findManoeuvres(offers) {
  const record = recordOf();
  const problem = act.obstacle(record);
  if (problem) return warn(problem, "estimate");
  note("Looking for manoeuvres ...");
  await act.attempt(async () => {
    manoeuvres = { of: record.id, found: await get(`/records/${record.id}/manoeuvres`) };
    note("");
    fillOffers(offers);
  });
}

/** What was found; nothing before it was asked for. */
export function fillOffers(offers) {
  const record = recordOf();
  if (manoeuvres && manoeuvres.of !== record?.id) manoeuvres = null;
  if (!record || manoeuvres === null) return fill(offers);
  const { found } = manoeuvres;
  if (!found.length) {
    return fill(offers, make("p", {}, "No manoeuvre was found: nowhere does an input move "
      + "after a quiet stretch with an answer above the noise."));
  }
  const use = (one) => store(record, [...kept(record, "identify"), { ...one, use: "identify" }], true);
  fill(offers, make("h3", {}, count(found.length, "manoeuvre")),
    make("ul", {}, found.map((one, number) => make("li", {},
      button(`${plain(one.start)} to ${plain(one.end)} s`, () => look(one),
        { class: "link", "data-key": `look ${number}` }),
      make("span", { class: "soft" }, ` ${one.why} `),
      button("Identify", () => use({ start: one.start, end: one.end }),
        { "data-key": `take ${number}` })))),
    button("Use all as experiments", () => store(record, [
      ...pieces(record).filter((one) => one.use !== "identify"),
      ...found.map(({ start, end }) => ({ start, end, use: "identify" }))], true),
    { "data-key": "take all" }));
}
