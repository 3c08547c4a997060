// What the page knows: the server's session, and what this tab looks at.

export const state = {
  session: { records: [], models: [], revision: 0, folder: null },
  record: null, // id of the record looked at
  model: null, // id of the model in the result
  view: null, // { start, end } in seconds, or null for the whole record
  job: null, // { id, fraction, message, model }
  options: [], // the server's list
  chosen: {}, // option name -> value, only those changed
  compared: null, // what the last comparison found
  output: null, // the channel pair that the panels show
  input: null,
  gone: false,
};

const listeners = new Map();

/** Calls `listener` after each `tell(topic)` of one of `topics`. */
export function listen(topics, listener) {
  for (const topic of [topics].flat()) {
    if (!listeners.has(topic)) listeners.set(topic, new Set());
    listeners.get(topic).add(listener);
  }
}

/** Tells the parts of the page that listen to any of `topics`, each once. */
export function tell(...topics) {
  const called = new Set(topics.flatMap((topic) => [...(listeners.get(topic) ?? [])]));
  for (const listener of called) listener();
}

export const recordOf = (id = state.record) =>
  state.session.records.find((record) => record.id === id) ?? null;
export const modelOf = (id = state.model) =>
  state.session.models.find((model) => model.id === id) ?? null;
export const isDone = (model) => ["done", "ready", undefined].includes(model.state);
export const shownModels = () =>
  state.session.models.filter((model) => isDone(model) && model.shown !== false);
export const channelOf = (record, name) =>
  record?.channels.find((channel) => channel.name === name) ?? { name, unit: "" };

const KEPT = "tridentify-workbench";

/** What this browser keeps over a reload; the session itself is kept by the server. */
export function recall() {
  try {
    return JSON.parse(localStorage.getItem(KEPT)) ?? {};
  } catch {
    return {};
  }
}

export function remember(values) {
  try {
    localStorage.setItem(KEPT, JSON.stringify({ ...recall(), ...values }));
  } catch {
    // a browser that keeps nothing still works
  }
}
