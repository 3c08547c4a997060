// What the server is asked, and its refusals as one sentence each.

const GONE = "The workbench's server does not answer.";
const GONE_REMEDY = "Start it again with `tridentify app`; this page goes on by itself.";
const STRANGER = "This page was opened with the token of another server.";
const STRANGER_REMEDY = "Open the address that the server printed when it started; "
  + "records, ranges and models are all there.";

/** Where this page asks for what a program gives as `dt`. */
const STEP = ["give dt [s]", "give the seconds between its samples (the field below Open files)"];

/** This tab's name in the events of the server. */
export const CLIENT = Math.random().toString(36).slice(2, 12);

export class Refusal extends Error {
  constructor(message, remedy = "", code = "error", status = 0) {
    super(message);
    this.remedy = remedy;
    this.code = code;
    this.status = status;
  }

  get sentence() {
    return sentence(this);
  }
}

/** A refusal of the server as it is read: what was found, what to do. */
export function sentence({ message, remedy }) {
  return [message, (remedy ?? "").replace(...STEP)].filter(Boolean).map(stopped).join(" ");
}

function stopped(text) {
  const trimmed = text.trim();
  return /[.!?]$/.test(trimmed) ? trimmed : `${trimmed}.`;
}

async function refusalOf(answer) {
  if (answer.status === 403) return new Refusal(STRANGER, STRANGER_REMEDY, "stranger", 403);
  const body = await answer.json().catch(() => null);
  const error = body?.error;
  if (error) return new Refusal(error.message, error.remedy ?? "", error.code, answer.status);
  return new Refusal(`The server refused with status ${answer.status}`,
    "Reload the page; the session is kept", "status", answer.status);
}

async function sent(path, request) {
  const headers = { "X-Client": CLIENT, ...request.headers };
  try {
    return await fetch(`/api${path}`, { ...request, headers, credentials: "same-origin" });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refusal(GONE, GONE_REMEDY, "gone");
  }
}

async function answered(path, request = {}) {
  const answer = await sent(path, request);
  if (!answer.ok) throw await refusalOf(answer);
  return answer;
}

async function json(path, request) {
  const answer = await answered(path, request);
  if (answer.status === 204) return null;
  const text = await answer.text();
  return text ? JSON.parse(text) : null;
}

const withBody = (method) => (path, body = {}) =>
  json(path, { method, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });

export const get = (path, signal) => json(path, { signal });
export const post = withBody("POST");
export const patch = withBody("PATCH");
export const remove = (path) => json(path, { method: "DELETE" });

/** Files chosen or dropped, several in one request. */
export function upload(files, dt) {
  const body = new FormData();
  for (const file of files) body.append("files", file, file.name);
  if (dt) body.append("dt", String(dt));
  return json("/records/upload", { method: "POST", body });
}

/** A file of the server as `{name, blob}`. */
export async function download(path) {
  const answer = await answered(path);
  const told = answer.headers.get("Content-Disposition") ?? "";
  const name = /filename="?([^";]+)"?/.exec(told)?.[1] ?? path.split("/").pop();
  return { name, blob: await answer.blob() };
}

export function query(values) {
  const pairs = Object.entries(values).filter(([, value]) => value !== undefined && value !== null);
  return `?${new URLSearchParams(pairs)}`;
}
