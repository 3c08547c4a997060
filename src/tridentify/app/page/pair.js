// Which output and input the panels show, and whether a record has them.

import { panelOf } from "./details.js";
import { warn } from "./messages.js";
import { distinct } from "./panel_parts.js";
import { recordOf, state } from "./state.js";

let pairs = []; // { output, input } of the ticked models

export const outputs = () => distinct(pairs.map((one) => one.output));
export const inputs = () => distinct(pairs.map((one) => one.input));

/** Chooses an output and an input that the models have. */
export async function choosePair(models) {
  const found = await Promise.all(models.map((model) =>
    panelOf(model.id, "bode", model.record)));
  pairs = found.flatMap((one) => one.pairs.map(({ output, input }) => ({ output, input })));
  if (!pairs.some((one) => one.output === state.output)) state.output = pairs[0]?.output ?? null;
  const driving = pairs.filter((one) => one.output === state.output);
  if (!driving.some((one) => one.input === state.input)) state.input = driving[0]?.input ?? null;
}

/** Whether a record has the channels of the ticked models; which it lacks is said. */
export function suits(id) {
  const record = recordOf(id);
  const own = new Set(record.channels.map((one) => one.name));
  const lacking = distinct(pairs.flatMap(({ output, input }) => [input, output]))
    .filter((name) => !own.has(name));
  if (lacking.length) {
    warn(`${record.name} has no channel ${lacking.join(", ")}, which the ticked models describe; `
      + "choose a record with the same channels.");
  }
  return !lacking.length;
}
