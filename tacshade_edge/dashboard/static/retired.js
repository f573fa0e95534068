// Sensors that this browser no longer shows. Their retained topics remain: only a sensor may clear its own.

const KEPT = "tacshade-removed";
const removed = new Set(JSON.parse(localStorage.getItem(KEPT) ?? "[]"));

const keep = () => localStorage.setItem(KEPT, JSON.stringify([...removed]));

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
