// The numbers of a contact and the sensor's rate, in tiles of constant width. An unknown number leaves its tile empty.

import { counted, number } from "./panels.js";

export const UNMEASURED = "touched, depth unknown";
const NAMES_MAX = 4;
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
  put("n-name", named.map(({ name, probability }) => `${name} ${number(100 * probability)} %`).join(", "));
}

export function showRates(health) {
  put("n-fps", number(health?.delivered_fps, 1));
  put("n-latency", number(health?.latency_ms?.p50));
  put("n-latency-99", number(health?.latency_ms?.p99));
}

function put(id, text, level) {
  const output = document.getElementById(id);
  if (output.value !== text) output.value = text;
  if (level) output.dataset.level = level;
  else delete output.dataset.level;
  output.closest("div").classList.toggle("is-unknown", text === "");
}
