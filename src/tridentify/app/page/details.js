// What the server knows of a model, fetched once.

import { get, query } from "./api.js";
import { state } from "./state.js";

const PIXELS = 1000;

const models = new Map();
const panels = new Map();

/** All of a model. */
export async function detailOf(id) {
  if (!models.has(id)) keep(models, id, get(`/models/${id}`));
  return models.get(id);
}

/** Takes over what came with the end of an estimate. */
export const known = (detail) => models.set(detail.id, detail);

export async function panelOf(id, panel, record) {
  const key = `${id} ${panel} ${record}`;
  if (!panels.has(key)) {
    const path = `/models/${id}/panel/${panel}${query({ record, pixels: PIXELS })}`;
    keep(panels, key, get(path));
  }
  return panels.get(key);
}

/** What was fetched before a record was changed is not shown after it. */
export function forget() {
  models.clear();
  forgetPictures();
}

/** The same where nothing is told anew: a model on another record is drawn on what that now is. */
export function forgetPictures() {
  panels.clear();
  state.compared = null;
}

function keep(place, key, promise) {
  place.set(key, promise);
  promise.catch(() => place.delete(key));
}
