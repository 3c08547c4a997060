// Which stretch of the record is looked at.

import { recordOf, state, tell } from "./state.js";

/** Start and end of the whole record, in seconds. */
const whole = () => [0, recordOf()?.duration ?? 1];
export const extent = () => (state.view ? [state.view.start, state.view.end] : whole());

export function look(view) {
  const [first, last] = whole();
  if (!view) state.view = null;
  else {
    const record = recordOf();
    const least = Math.max((record.dt || 0) * 4, (last - first) * 1e-7);
    const width = Math.min(Math.max(view.end - view.start, least), last - first);
    const start = Math.min(Math.max(view.start, first), last - width);
    state.view = width >= last - first ? null : { start, end: start + width };
  }
  tell("view");
}

export function zoomed(by, at = 0.5) {
  const [start, end] = extent();
  const centre = start + at * (end - start);
  look({ start: centre - (centre - start) * by, end: centre + (end - centre) * by });
}

export function shifted(by) {
  const [start, end] = extent();
  look({ start: start + by * (end - start), end: end + by * (end - start) });
}
