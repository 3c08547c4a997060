// Doubts as a list, the worst first as the server ranks them.

import { make } from "./dom.js";

const SEVERITIES = ["error", "caution", "note"];

const severityOf = ({ severity }) => {
  if (SEVERITIES.includes(severity)) return severity;
  return severity === "warning" ? "caution" : "note";
};

/** The worst severity among findings, or "fine". */
export const worst = (findings) =>
  SEVERITIES.find((one) => (findings ?? []).some((finding) => severityOf(finding) === one)) ?? "fine";

const item = (finding) => make("li", { class: severityOf(finding) },
  make("p", {}, make("span", { class: "offscreen" }, `${severityOf(finding)}: `), finding.message),
  finding.remedy ? make("p", { class: "remedy" }, finding.remedy) : null);

/** An ordered list of findings, or null where there is none. */
export const findingList = (findings) =>
  (findings?.length ? make("ol", { class: "findings" }, findings.map(item)) : null);
