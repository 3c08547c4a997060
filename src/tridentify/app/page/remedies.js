// What a finding advises, as options of this page: only where the advice is exactly that.

import * as act from "./actions.js";
import { button } from "./dom.js";
import { recordOf, state } from "./state.js";

/** What only the three models take, and not with the other of the two. */
const COLOURED = { noise: "ar", loss: "squared", method: "three-model" };
const ROBUST = { loss: "huber", noise: "auto", method: "three-model" };

/** Code of a finding, what its remedy says, and the options that this comes to. */
const REMEDIES = [
  ["intersample", /^State intersample='/, { intersample: "auto" }],
  ["delay", /delay='free'/, { delay: "free" }],
  ["drift", /^(Estimate|Try) a drift (along )?\(drift=True/, { drift: "yes" }],
  ["drift", /^Estimate an offset \(offset=True/, { offset: "yes" }],
  ["drift", /^Estimate an offset and a drift \(offset=True, drift='auto'/,
    { offset: "yes", drift: "auto" }],
  ["drift", /^Use a noise model \(noise='ar'/, COLOURED],
  ["noise-model", /^Use noise='ar'/, COLOURED],
  ["noise-model", /^Compare with ThreeModel\(noise='white'\)/, { ...COLOURED, noise: "white" }],
  ["order-low", /select_structure/, { poles: "auto", zeros: "auto" }],
  ["order-high", /select_structure/, { poles: "auto", zeros: "auto" }],
  ["bad-samples", /loss='huber'/, ROBUST],
  ["outside-the-record", /^Fix the pole at zero .*--fix a0=0/, { fixed: "a0=0" }],
];

/** Options that do what a finding advises, or null. */
export const optionsOf = ({ code, remedy }) =>
  REMEDIES.find(([one, said]) => one === code && said.test(remedy ?? ""))?.[2] ?? null;

/** Sets the options that a finding advises and estimates again; null where there are none. */
export function remedyButton(finding, model) {
  const changes = optionsOf(finding);
  if (!changes || !recordOf(model?.record ?? state.record)) return null;
  const now = model?.options ?? state.chosen;
  if (changes.fixed && now.fixed) return null; // what is known already stays
  const news = state.options.filter(({ name, default: usual }) =>
    name in changes && String(now[name] ?? usual) !== changes[name]);
  if (!news.length) return null;
  const said = news.map(({ name, label }) => `${label} = ${changes[name]}`).join(", ");
  return button(`Estimate with ${said}`, () => act.estimateWith(changes, model),
    { "data-key": `remedy ${finding.code} ${said}` });
}
