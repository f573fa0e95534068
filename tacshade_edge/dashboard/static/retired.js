// Sensors that this browser does not show any more. The retained topics stay: only a sensor may clear its own.

const KEPT = "tacshade-removed";
const removed = new Set(JSON.parse(localStorage.getItem(KEPT) ?? "[]"));

const keep = () => localStorage.setItem(KEPT, JSON.stringify([...removed]));

export const isRemoved = (sensor) => removed.has(sensor);

export function remove(sensor) {
  removed.add(sensor);
  keep();
}

/** One that works again, or all of them. */
export function restore(sensor) {
  if (sensor === undefined) removed.clear();
  else if (!removed.delete(sensor)) return;
  keep();
}
