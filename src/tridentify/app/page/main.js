// Starts the page: its parts, the session, what comes from other tabs.

import * as act from "./actions.js";
import { CLIENT } from "./api.js";
import { byId } from "./dom.js";
import { startExport } from "./export.js";
import { startLines } from "./lines.js";
import { note } from "./messages.js";
import { startOptions } from "./options.js";
import { startPanels } from "./panels.js";
import { startRecordView } from "./record_view.js";
import { startResult } from "./result.js";
import { listen, recall, remember, state, tell } from "./state.js";
import { startTray } from "./tray.js";

const DISK = "disk"; // who changed something, where it was no page
const THEMES = ["auto", "light", "dark"];

// ---------------------------------------------------------------- colours
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  byId("theme").textContent = `Colours: ${theme}`;
  byId("theme").setAttribute("aria-label", theme === "auto"
    ? "Colours: as the system has them" : `Colours: ${theme}`);
  remember({ theme });
  tell("theme");
}

function startTheme(theme = "auto") {
  setTheme(theme);
  byId("theme").addEventListener("click", () => {
    const now = document.documentElement.dataset.theme;
    setTheme(THEMES[(THEMES.indexOf(now) + 1) % THEMES.length]);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => tell("theme"));
}

// ---------------------------------------------------------------- undo
function startUndo() {
  byId("undo").addEventListener("click", () => act.moveInTime("undo"));
  byId("redo").addEventListener("click", () => act.moveInTime("redo"));
  addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.target.matches("input, select, textarea")) return;
    const key = event.key.toLowerCase();
    const direction = key === "y" || (key === "z" && event.shiftKey) ? "redo" : "undo";
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    act.moveInTime(direction);
  });
  listen(["session", "online"], () => {
    byId("undo").disabled = !state.session.can_undo || state.gone;
    byId("redo").disabled = !state.session.can_redo || state.gone;
    const folder = state.session.folder ?? "";
    byId("folder").textContent = folder.split(/[\\/]/).pop();
    byId("folder").title = folder;
  });
}

// ---------------------------------------------------------------- other tabs
function listenToServer() {
  const events = new EventSource("/api/events");
  events.addEventListener("message", ({ data }) => {
    const event = JSON.parse(data);
    if (event.type === "files") return act.check();
    if (event.type !== "session" || [CLIENT, DISK].includes(event.client)) return;
    if (event.revision <= state.session.revision || state.job) return;
    act.attempt(async () => {
      await act.loadSession();
      tell("result");
      note("Changed in another tab; this one shows the same now.");
    });
  });
  events.addEventListener("error", () => { if (!state.gone) act.check(); });
  addEventListener("focus", () => { if (!state.gone && !state.job) act.check(); });
}

async function start() {
  const kept = recall();
  Object.assign(state, { record: kept.record ?? null, model: kept.model ?? null,
    chosen: kept.chosen ?? {} });
  startUndo();
  startTray();
  startRecordView();
  startResult();
  startPanels();
  startLines();
  startExport();
  startTheme(kept.theme);
  await Promise.all([act.attempt(act.loadSession), startOptions()]);
  tell("result");
  listenToServer();
}

start();
