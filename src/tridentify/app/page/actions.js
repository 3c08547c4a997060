// Everything a person can do: asks the server, keeps the session, tells the page.

import { get, patch, post, query, remove, sentence, upload } from "./api.js";
import { clear, explain, note, passing, settled, warn } from "./messages.js";
import { forget, forgetPictures, known } from "./details.js";
import { modelOf, recordOf, remember, state, tell } from "./state.js";

const LOOK = 0.2; // seconds after which the server tells how far an estimate is, or at its end
const OLDER = "Models from before keep their numbers and are marked; estimate again for new ones.";
const KNOCK = 1000; // milliseconds between two knocks at a server that is gone

/** Runs `work`; what goes wrong is said in a sentence. */
export async function attempt(work) {
  try {
    const result = await work();
    return result === undefined ? true : result;
  } catch (error) {
    if (error.code === "gone") knock();
    explain(error);
    return null;
  }
}

// ---------------------------------------------------------------- session
let changing = Promise.resolve(); // settles when every change that was sent is answered

/** The session as the server holds it: an answer from before a change of this page is none. */
export async function loadSession() {
  let session;
  let awaited;
  do {
    awaited = changing;
    await awaited;
    session = await get("/session");
  } while (awaited !== changing);
  take(session);
}

/** Sends a change, which a session asked for meanwhile has to hold. */
function sent(change) {
  changing = Promise.allSettled([changing, change]);
  return change;
}

/** Takes over a session of the server, and looks at what is still there. */
export function take(session, ...topics) {
  const missing = newly("missing_file", session.records);
  const changed = newly("changed_file", session.records);
  const others = session.records.filter((record) => isOther(record, recordOf(record.id)));
  const sameRecords = JSON.stringify(session.records) === JSON.stringify(state.session.records);
  state.session = session;
  if (others.length) {
    forget();
    settled(); // what was refused of the older content
  }
  if (others.some(({ id }) => id === state.record)) state.view = null;
  if (!session.records.some((record) => record.missing_file)) clear("missing");
  const looked = state.record;
  if (!recordOf()) look(session.records.at(-1)?.id ?? null);
  if (!modelOf()) state.model = session.models.at(-1)?.id ?? null;
  if (missing.length) {
    warn(missing.map(({ name }) => `The file of ${name} is no longer where it was opened; `
      + "its models are kept, for new ones put it back or open it again.").join("\n"), "missing");
  }
  if (changed.length) {
    warn(changed.map(({ name, changed_file: text }) => `${name}: ${text} ${OLDER}`).join("\n"),
      "changed");
  }
  const records = sameRecords && looked === state.record ? [] : ["records", "record"];
  tell("session", "models", ...records, ...(others.length ? ["result"] : []), ...topics);
}

/** Records of which something is said that was not said of them before. */
const newly = (what, records) =>
  records.filter((record) => record[what] && record[what] !== recordOf(record.id)?.[what]);

/** Whether a record's file has another content than what is known of it. */
const isOther = (record, old) => Boolean(old) && old.content !== record.content;

export async function moveInTime(direction) {
  const done = passing();
  await attempt(async () => {
    const session = await post(`/${direction}`);
    done();
    forget();
    take(session, "result");
    note(direction === "undo" ? "Undone" : "Done again");
  });
}

let cut = null; // the model of an estimate that was under way when the server went

/** Waits for the server to come back, then goes on with its session. */
export async function knock() {
  if (state.gone) return;
  state.gone = true;
  tell("online");
  while (state.gone) {
    await new Promise((done) => setTimeout(done, KNOCK));
    try {
      const session = await get("/session");
      state.gone = false;
      clear("gone");
      take(session);
      const back = "The server is back; records, ranges and models are as they were.";
      if (cut && !modelOf(cut)) warn(`${back} The estimate that was under way ended with it: start it again.`, "estimate");
      else note(back);
      cut = null;
    } catch (error) {
      if (error.code !== "gone") {
        state.gone = false;
        clear("gone");
        explain(error);
      }
    }
  }
  tell("online");
}

// ---------------------------------------------------------------- records
function look(id) {
  state.record = id;
  state.view = null;
  remember({ record: id });
}

export function lookAt(id) {
  if (id !== state.record) settled("missing");
  look(id);
  tell("record", "records");
}

export const openFile = (path, dt) => opened(() => post("/records", { path, dt }), path);
export const uploadFiles = (files, dt) =>
  opened(() => upload(files, dt), files.length === 1 ? files[0].name : `${files.length} files`);

async function opened(ask, what) {
  note(`Reading ${what} ...`);
  const done = passing();
  await attempt(async () => {
    const answer = await ask();
    done();
    await loadSession();
    const last = answer.records.at(-1);
    if (last) {
      lookAt(last.id);
      note(`${answer.records.map((record) => record.name).join(", ")} opened`);
    }
    const failed = (answer.failed ?? []).map((one) => `${one.name}: ${sentence(one)}`);
    if (failed.length) warn(failed.join("\n"));
    if (!last) note("");
  });
}

/** Changes a record; the page shows what the server then holds. */
export async function changeRecord(id, changes) {
  const before = begun(id, changes);
  const done = passing(); // an estimate that is refused meanwhile has its own word
  return attempt(async () => {
    const card = await sent(patch(`/records/${id}`, changes)).catch(refused);
    done();
    changed(card, before);
    return card;
  });
}

/** What was told of a record before; a second change before the first is answered starts from it. */
function begun(id, changes) {
  const own = recordOf(id);
  const before = own && told(own);
  if (own) Object.assign(own, changes);
  return before;
}

/** After a refusal the page shows what the server holds. */
async function refused(error) {
  if (error.code !== "gone") await loadSession();
  throw error;
}

function changed(card, before) {
  state.session.records = state.session.records.map((old) => (old.id === card.id ? card : old));
  const judged = told(card) !== before;
  if (judged) forget();
  else forgetPictures();
  Object.assign(state.session, { revision: card.revision, can_undo: true, can_redo: false });
  tell("session", "records", "record", ...(judged ? ["result"] : []));
}

/** What of a record is told of its models: its name, and the ranges on which they are tested. */
const told = ({ name, ranges }) =>
  JSON.stringify([name, ranges.filter(({ use }) => use === "validate")]);

/** What was said of a changed file is known. */
export async function fileSeen(id) {
  await attempt(async () => {
    await patch(`/records/${id}`, { changed_file: "" });
    clear("changed");
    await loadSession();
  });
}

export async function dropRecord(id) {
  const done = passing();
  await attempt(async () => {
    await remove(`/records/${id}`);
    done();
    await loadSession();
  });
}

// ---------------------------------------------------------------- models
/** What speaks against an estimate before it is asked for, or null. */
export function obstacle(record) {
  if (!record) return "Open a record first: drop a file on the page or choose one on the left.";
  if (record.missing_file) {
    return `The file of ${record.name} is gone; put it back where it was or open it again.`;
  }
  if (!record.inputs.length && !record.references.length) {
    return "No channel is an input; mark the one that was moved as input on the left.";
  }
  if (!record.outputs.length) {
    return "No channel is an output; mark the one that answered as output on the left.";
  }
  return unmoved(record);
}

/** Said where no input moves in the whole record. */
function unmoved(record) {
  const driven = [...record.inputs, ...record.references];
  const moves = ({ name, minimum, maximum }) => driven.includes(name) && minimum !== maximum;
  if (record.channels.some(moves)) return null;
  return `${driven.join(", ")} never moves in this record, so that nothing tells how the plant `
    + "answers; mark the channel that was moved as input on the left, or open another record.";
}

/** Starts an estimate of the record looked at, changed first, and follows it to its end. */
export async function estimate(changes = null) {
  if (recordOf()?.missing_file) await attempt(loadSession); // it may be back
  const record = recordOf();
  const problem = obstacle(record);
  if (problem) {
    if (record && changes) await changeRecord(record.id, changes);
    return warn(problem, record?.missing_file ? "missing" : "estimate");
  }
  settled();
  if (state.job) await cancel();
  return attempt(async () => {
    const before = begun(record.id, changes);
    const asked = { record: record.id, options: state.chosen, alone: !state.keep, changes };
    const { job, model, record: card } = await post("/models", asked).catch(refused);
    const following = follow(job, model);
    if (changes) changed(card, before);
    await following;
  });
}

/** Estimates with some options changed: those of `model`, on its record, or those of the page. */
export function estimateWith(changes, model = null) {
  const usual = Object.fromEntries(state.options.map((one) => [one.name, String(one.default)]));
  const wanted = Object.entries({ ...(model?.options ?? state.chosen), ...changes });
  state.chosen = Object.fromEntries(
    wanted.filter(([name, value]) => String(value) !== usual[name]));
  remember({ chosen: state.chosen });
  tell("chosen");
  if (model && model.record !== state.record) lookAt(model.record);
  return estimate();
}

async function follow(id, model) {
  state.job = { id, model, fraction: 0, message: "starting" };
  tell("job");
  try {
    while (state.job?.id === id) {
      const job = await get(`/jobs/${id}${query({ wait: LOOK })}`);
      if (state.job?.id !== id) return;
      if (ENDS[job.state]) {
        state.job = null;
        await ENDS[job.state](job, model);
        return;
      }
      Object.assign(state.job, { fraction: job.fraction, message: job.message });
      tell("job");
    }
  } catch (error) {
    if (error.code === "gone") cut = model;
    throw error;
  } finally {
    if (state.job?.id === id) state.job = null;
    tell("job");
  }
}

const ENDS = {
  async done({ session, detail }, model) {
    settled("changed");
    known(detail);
    state.model = model;
    remember({ model });
    take(session, "result");
  },
  async failed(job) {
    await loadSession();
    warn(sentence(job.error ?? { message: job.message }), "estimate");
  },
  async cancelled() {
    await loadSession();
    note("Cancelled");
  },
};

export async function cancel() {
  const job = state.job;
  if (!job) return;
  state.job = null;
  tell("job");
  await attempt(async () => {
    await remove(`/jobs/${job.id}`);
    await loadSession();
    note("Cancelled");
  });
}

export function choose(id) {
  settled();
  state.model = id;
  remember({ model: id });
  const model = modelOf(id);
  if (model && model.shown === false) show(id, true);
  tell("models", "result");
}

export async function show(id, shown) {
  modelOf(id).shown = shown;
  tell("models");
  await attempt(() => patch(`/models/${id}`, { shown }));
}

export async function rename(id, name) {
  await attempt(async () => {
    await patch(`/models/${id}`, { name });
    await loadSession();
    tell("result");
  });
}

export async function dropModel(id) {
  await attempt(async () => {
    await remove(`/models/${id}`);
    await loadSession();
    tell("result");
  });
}

/** Asks whether the server is still there and what has changed without this tab. */
export async function check() {
  await attempt(loadSession);
}
