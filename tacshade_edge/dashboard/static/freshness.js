// Whether the page shows the sensor's present state. A retained message reports the past, never the present.

const STALE_MS = 3000;

/**
 * view: arrival times as of performance.now(); retained messages do not change them.
 * paused: no news is expected. gone: no connection, or the sensor reports that it does not work, or it sends nothing at all.
 * frames, health: whether the shown ones are old. words: what is old, and its age; empty when nothing is.
 */
export function freshness(view, { connected, works, state, paused }) {
  const now = performance.now(), since = (at) => (at === null ? Infinity : now - at);
  const frames_ms = since(view.heard_ms), health_ms = since(view.health_ms), any_ms = Math.min(frames_ms, health_ms);
  const silent = !paused && any_ms > STALE_MS && since(view.chosen_ms) > STALE_MS;
  const gone = !connected || !works || silent;
  const frames = gone || (!paused && view.heard_ms !== null && frames_ms > STALE_MS);
  const heard_ms = any_ms < Infinity ? any_ms : view.health?.wall_ns ? Math.max(Date.now() - view.health.wall_ns / 1e6, 0) : null;
  const shown = view.health !== null || view.heard_ms !== null;
  let words = "";
  if (gone && shown) words = `${why(connected, works, state)}: what you see is old, last updated ${heard_ms === null ? "before this page opened" : `${age(heard_ms)} ago`}.`;
  else if (frames && !gone) words = `Last frame ${age(frames_ms)} ago: what you see is old.`;
  return { gone, frames, health: gone || health_ms > STALE_MS, words };
}

function why(connected, works, state) {
  if (!connected) return "Not connected";
  return works ? "This sensor publishes nothing" : `This sensor is ${state ?? "unknown"}`;
}

function age(ms) {
  const s = Math.floor(ms / 1000), units = [[86400, "days"], [3600, "h"], [60, "min"]];
  const [seconds, unit] = units.find(([seconds]) => s >= 2 * seconds) ?? [1, "s"];
  return `${Math.floor(s / seconds)} ${unit}`;
}
