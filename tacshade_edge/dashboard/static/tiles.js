// The numbers of a contact and the sensor's rate, in tiles of constant width. An unknown number leaves its tile empty.

import { counted, dotOf, number } from "./panels.js";

export const UNMEASURED = "touched, depth unknown";
const NAMES_MAX = 4;
const STARTED_S = 5, SETTLED_S = 30;
const ENOUGH = 0.9; // of the rate that was asked for
const SLIPS = [["sticks", "good"], ["in part", "warn"], ["slides", "bad"]];

export function showContact(contact) {
  const touched = contact?.touched === 1, free = contact?.contact === 0 && !touched, { objects, slip } = contact ?? {};
  const known = contact && contact.contact !== null; // null: the frame cannot be used
  const found = !known ? "" : free ? "none" : touched ? UNMEASURED : counted(objects, "object");
  put("n-contact", found, touched ? "touched" : known && !free ? "good" : undefined);
  const [words, level] = free ? ["none"] : SLIPS[slip] ?? [""];
  put("n-slip", words, level);
  put("n-depth", number(contact?.depth_max_mm, 2));
  put("n-area", number(contact?.area_mm2, 1));
  put("n-volume", number(contact?.volume_mm3, 1));
  put("n-place", free ? "none" : Number.isFinite(contact?.x_mm) ? `${number(contact.x_mm, 1)}, ${number(contact.y_mm, 1)} mm` : "");
}

/** Add an `event/object` to the names of this contact's objects; each label has one. */
export function withName(named, event) {
  return [...named.filter(({ label }) => label !== event.label), event].slice(-NAMES_MAX);
}

/** The tile appears with the first name: who teaches nothing needs none. */
export function showNames(named) {
  if (named.length) document.getElementById("named").hidden = false;
  const words = named.map(({ name, probability }) => `${name} ${number(100 * probability)} %`);
  put("n-name", words.join(", "));
  // Its points have the same colour, in the picture in space.
  document.getElementById("n-name").replaceChildren(...named.flatMap(({ label }, n) => [n ? ", " : "", dotOf(label), words[n]]));
}

/**
 * The rate and latencies that last: not those of a start, which opens the camera and warms up. The
 * slowest of a hundred need some seconds more.
 */
export function lasting({ delivered_fps, latency_ms, uptime_s } = {}) {
  const started = !(uptime_s < STARTED_S), settled = !(uptime_s < SETTLED_S);
  return { started, settled, fps: started ? delivered_fps : undefined, p50: started ? latency_ms?.p50 : undefined, p99: settled ? latency_ms?.p99 : undefined };
}

/** `asked`: the rate that the camera was asked for, if that is known. */
export function showRates(health, asked) {
  const { fps, p50, p99 } = lasting(health ?? {});
  put("n-fps", number(fps, 1), fps < ENOUGH * asked ? "warn" : undefined);
  put("n-latency", number(p50));
  put("n-latency-99", number(p99));
}

function put(id, text, level) {
  const output = document.getElementById(id);
  if (output.value !== text) output.value = text;
  if (level) output.dataset.level = level;
  else delete output.dataset.level;
  output.closest("div").classList.toggle("is-unknown", text === "");
}
