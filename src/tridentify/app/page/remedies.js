// What a finding advises, as options of this page: only where the advice is exactly that.

import * as act from "./actions.js";
import { get, query } from "./api.js";
import { button } from "./dom.js";
import { warn } from "./messages.js";
import { plain, seconds } from "./numbers.js";
import { recordOf, state } from "./state.js";

/** What only the three models take, and not with the other of the two. */
const COLOURED = { noise: "ar", loss: "squared", method: "three-model" };
const ROBUST = { loss: "huber", noise: "auto", method: "three-model" };

const STUCK = /^Mark (these samples|the repeats) as missing/;
const MARKED = /\bmark them as missing/i;
const MOST_MARKED = 100; // samples: more of them are not single ones
const CLIPPED = /^Mark as missing .* where it is ([^,]*), /;
const MOST_STRETCHES = 200; // more of them make no list that is read

/** Code of a finding, what its remedy says, and the options that this comes to: a row each. */
const REMEDIES = [
  ["intersample", /^State intersample='.*'auto'/, { intersample: "auto" }],
  ["intersample", /^State intersample='zoh' \(.*\)\.$/, { intersample: "zoh" }],
  ["intersample", /^State intersample='foh' \(.*\)\.$/, { intersample: "foh" }],
  ["intersample", /^State intersample='band-limited' \(.*\)\.$/, { intersample: "band-limited" }],
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
  ["controller", /controller='sampled' or 'continuous'/, { controller: "sampled" }],
  ["controller", /controller='sampled' or 'continuous'/, { controller: "continuous" }],
  ["outside-the-record", /^Fix the pole at zero .*--fix a0=0/, { fixed: "a0=0" }],
];

/** Options that do what a finding advises; several where it leaves the choice. */
const choicesOf = ({ code, remedy }) =>
  REMEDIES.filter(([one, said]) => one === code && said.test(remedy ?? ""))
    .map(([, , changes]) => changes);

/** The first of them, or null. */
export const optionsOf = (finding) => choicesOf(finding)[0] ?? null;

/** Buttons that do what findings of one kind advise, and estimate again. */
export const remedyButtons = (alike, model) => [
  ...choicesOf(alike[0]).map((changes) => remedyButton(alike[0], changes, model)),
  ...alike.flatMap((finding) =>
    [markButton, clippedButton, stuckButton].map((made) => made(finding, model)))];

/** Marks the samples that a finding names; null where it does not name each of them. */
function markButton({ code, remedy, times = [] }, model) {
  const record = model && recordOf(model.record);
  const fits = code === "bad-samples" && MARKED.test(remedy ?? "");
  if (!record || !fits || !times.length || times.length > MOST_MARKED) return null;
  const mark = async () => {
    await leaveOut(record, times.map((time) => around(time - record.t0, record.dt)), model);
  };
  return button("Leave them out and estimate", mark, { "data-key": `mark ${times[0]}` });
}

/** Leaves out where a sensor or the recording hung; null where the samples are not named. */
function stuckButton({ code, remedy, times = [], outputs = [] }, model) {
  const record = model && recordOf(model.record);
  if (!record || code !== "stuck-sensor" || !STUCK.test(remedy ?? "") || !times.length) return null;
  const found = stretches(times.map((time) => time - record.t0), record.dt);
  const where = found.length > 1 ? `in ${found.length} stretches` : span(found[0]);
  const channel = outputs.join(", ");
  const what = remedy.includes("the repeats") ? `the repeats of ${channel}` : `where ${channel} hung`;
  const leave = () => leaveOut(record, found.map(({ first, last }) => ({
    start: around(first, record.dt).start, end: around(last, record.dt).end })), model);
  return button(`Leave out ${what}, ${where}, and estimate`, leave,
    { "data-key": `stuck ${channel} ${times[0]}` });
}

const span = ({ first, last }) =>
  (first === last ? `at ${seconds(first)}` : `from ${plain(first)} to ${seconds(last)}`);

/** Times of samples as stretches without a gap: `{ first, last }`. */
function stretches(times, dt) {
  const found = [];
  for (const time of times) {
    const now = found.at(-1);
    if (now && time - now.last < 1.5 * dt) now.last = time;
    else found.push({ first: time, last: time });
  }
  return found;
}

/** Marks stretches of a record as bad samples, and estimates again. */
async function leaveOut(record, found, model) {
  if (found.length > MOST_STRETCHES) {
    return warn(`They stand in ${found.length} stretches, too many to list; write them as empty `
      + "cells into the file.");
  }
  const bad = [...record.bad, ...found].sort((one, other) => one.start - other.start);
  if (await act.changeRecord(record.id, { bad })) await act.estimateWith({}, model);
}

/** Leaves out what a sensor at its limit has clipped; null where no limit is named. */
function clippedButton({ code, remedy, outputs = [] }, model) {
  const record = model && recordOf(model.record);
  const [, limits] = (code === "saturation" && CLIPPED.exec(remedy ?? "")) || [];
  if (!record || !limits || outputs.length !== 1) return null;
  const [channel] = outputs;
  const ends = limits.split(" or ").map((end) => end.split(" "));
  const place = `/records/${record.id}/stretches${query({ channel, ...Object.fromEntries(
    ends.map(([side, limit]) => [side === ">=" ? "high" : "low", limit])) })}`;
  const leave = () => act.attempt(async () => {
    const found = await get(place);
    if (found.length > MOST_STRETCHES) {
      return warn(`${channel} is at its limit in ${found.length} stretches, too many to list; `
        + "record again with a wider range.");
    }
    await leaveOut(record, found, model);
  });
  const words = ends.map(([side, limit]) => `${side === ">=" ? "\u2265" : "\u2264"} ${limit}`);
  return button(`Leave out where ${channel} ${words.join(" or ")} and estimate`, leave,
    { "data-key": `clipped ${channel}` });
}

const around = (time, dt) => ({ start: Math.max(0, time - dt / 4), end: time + dt / 4 });

function remedyButton(finding, changes, model) {
  if (!recordOf(model?.record ?? state.record)) return null;
  const now = model?.options ?? state.chosen;
  if (changes.fixed && now.fixed) return null; // what is known already stays
  const news = state.options.filter(({ name, default: usual }) =>
    name in changes && String(now[name] ?? usual) !== changes[name]);
  if (!news.length) return null;
  const said = news.map(({ name, label }) => `${label} = ${changes[name]}`).join(", ");
  return button(`Estimate with ${said}`, () => act.estimateWith(changes, model),
    { "data-key": `remedy ${finding.code} ${said}` });
}
