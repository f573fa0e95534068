// Which map of a sensor the page should show now.

import { zeroMap } from "./geometry.js";

export const CONTACT = 1, INVALID = 2, TOUCHED = 32;
const RELEASE_LOST_MS = 500, MESSAGES_KEPT = 64, HEADER_BYTES = 96, SEQ_AT = 8;
export const VALUES = { height: "height_mm", cloud: "points_mm", shear: "shear_mm", sigma: "sigma_mm" };

const TOGETHER_MS = 300;

/**
 * The decoded message of one kind that belongs to the shown map; undefined while there is nothing new.
 * A message of a later map waits for that map, one of an earlier map is dropped; null: the shown one is of another map.
 */
export function partOfMap(view, what, decoded) {
  const payload = view[what], seq = view.map?.seq ?? null, { with_map } = view;
  if (payload && payload.length < HEADER_BYTES) {
    decoded(payload); // counts it as damaged
    view[what] = null;
  } else if (payload && seq !== null) {
    const of = new DataView(payload.buffer, payload.byteOffset).getUint32(SEQ_AT, true);
    if (((of - seq) | 0) <= 0) view[what] = null; // the number after 2^32 - 1 is 0
    if (of === seq) {
      with_map[what] = seq;
      return decoded(payload, VALUES[what]) ?? undefined;
    }
  }
  if (with_map[what] === seq || performance.now() - view.shown_ms < TOGETHER_MS) return undefined;
  with_map[what] = seq;
  return null;
}

/** Keep a message with numbers until its map is drawn, whose header has 32 bits of the frame's number. */
export function keep(messages, message) {
  messages.set(message.seq >>> 0, message);
  if (messages.size > MESSAGES_KEPT) messages.delete(messages.keys().next().value);
}

export function keepContact(view, contact) {
  view.contact = contact;
  keep(view.contacts, contact);
}

/** The numbers of the shown map; for a moment those of the previous one, then null if they have not arrived. */
export function contactOfMap(view) {
  const { map, contact } = view;
  if (!map || contact === null) return contact;
  const free = contact.contact !== 1 && !(map.flags & CONTACT); // these continue after the last map
  const own = free ? contact : view.contacts.get(map.seq);
  if (own || performance.now() - view.shown_ms > TOGETHER_MS) view.numbers = own ?? null;
  return view.numbers;
}

/** The `touch` of the shown map; for a moment the previous one, then null if none has arrived. */
export function touchOfMap(view) {
  const own = view.touches.get(view.map.seq), now = performance.now();
  if (own) view.touch_ms = now;
  if (own || now - view.touch_ms > TOGETHER_MS) view.touch = own ?? null;
  return view.touch;
}

/** The map to draw now, or null if the shown one is current. decoded(payload): null if damaged. */
export function nextMap(view, geometry, decoded) {
  if (view.height) {
    const map = decoded(view.height, VALUES.height);
    view.height = null;
    if (map) return map;
  }
  const free = view.contact?.contact === 0, unknown = view.contact?.contact === null;
  if (!view.map) return free && geometry ? zeroMap(geometry) : null;
  // The only height map of a release can be lost; `contact` still reports that nothing touches.
  const lost = view.map.flags & CONTACT && geometry && performance.now() - view.height_ms > RELEASE_LOST_MS;
  if (free && lost) return zeroMap(geometry);
  if (unknown && lost) return { ...zeroMap(geometry), flags: INVALID };
  return geometry !== view.drawnFor ? view.map : null;
}
