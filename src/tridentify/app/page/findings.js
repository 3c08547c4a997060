// Doubts as a list, the worst first as the server ranks them.

import { make } from "./dom.js";
import { remedyButtons } from "./remedies.js";

const SEVERITIES = ["error", "caution", "note"];

const severityOf = ({ severity }) => {
  if (SEVERITIES.includes(severity)) return severity;
  return severity === "warning" ? "caution" : "note";
};

/** The worst severity among findings, or "fine". */
export const worst = (findings) =>
  SEVERITIES.find((one) => (findings ?? []).some((finding) => severityOf(finding) === one)) ?? "fine";

const kindOf = (finding) => [finding.code, severityOf(finding), finding.remedy].join("\n");

/** Findings of one kind together, such as one an output, where the first of them stands. */
function grouped(findings) {
  const groups = new Map();
  for (const finding of findings) {
    groups.set(kindOf(finding), [...(groups.get(kindOf(finding)) ?? []), finding]);
  }
  return [...groups.values()];
}

const item = (alike, model) => make("li", { class: severityOf(alike[0]) },
  alike.map(({ message }, at) => make("p", {},
    at ? null : make("span", { class: "offscreen" }, `${severityOf(alike[0])}: `), message)),
  alike[0].remedy ? make("p", { class: "remedy" }, alike[0].advice ?? alike[0].remedy) : null,
  remedyButtons(alike, model));

/** An ordered list of findings, of `model` or of the record looked at; null where there is none. */
export const findingList = (findings, model = null) => (findings?.length
  ? make("ol", { class: "findings" }, grouped(findings).map((alike) => item(alike, model))) : null);
