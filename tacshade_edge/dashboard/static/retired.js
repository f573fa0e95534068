// Sensors that this browser no longer shows. Their retained topics remain: only a sensor may clear its own.

import { store, stored } from "./stored.js";

const KEPT = "tacshade-removed";
const removed = new Set(known());

const keep = () => store(KEPT, JSON.stringify([...removed]));

/** The names that were kept; none if what is kept is no list. */
function known() {
  try {
    const names = JSON.parse(stored(KEPT) ?? "[]");
    return Array.isArray(names) ? names.filter((name) => typeof name === "string") : [];
  }
  catch { return []; }
}

export const isRemoved = (sensor) => removed.has(sensor);

export function remove(sensor) {
  removed.add(sensor);
  keep();
}

/** Show one sensor again, since it works, or all of them. */
export function restore(sensor) {
  if (sensor === undefined) removed.clear();
  else if (!removed.delete(sensor)) return;
  keep();
}
