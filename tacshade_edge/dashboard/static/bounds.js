// Checks of messages. Anyone who can publish to the broker can send anything: what the page cannot show is an error
// here and is counted; what is too long is cut before it is drawn.

export const TEXT_MAX = 300, ENTRIES_MAX = 100, PARTS_MAX = 32, SENSORS_MAX = 64, FINGERS_MAX = 16;
const BYTES_MAX = 1 << 20, DEPTH_MAX = 6;
const SIDE_MAX = 4096, IMAGE_SIDE_MAX = 8192, AWAY_MAX_PX = 1 << 16, SCALE_MAX_MM = 1000;
const OBJECTS_MAX = 64, QUANTITIES_MAX = 32, QUANTITY_MAX = 1e6;
const NAME = /^[A-Za-z0-9_-]{1,64}$/;
const OBJECT = /^[A-Za-z0-9_.-]{1,64}$/;
const NUMBERS_OF_CONTACT = ["contact", "seq", "depth_max_mm", "area_mm2", "volume_mm3", "objects", "x_mm", "y_mm", "slip", "fps", "touched"];
const NUMBERS_OF_REPLAY = ["position_s", "length_s", "speed", "frame"];
const GEOMETRY = { // minimum and maximum; a camera without a distance is orthographic
  mm_per_px: [1e-6, 1000], radius_px: [1, IMAGE_SIDE_MAX],
  row_c: [-AWAY_MAX_PX, AWAY_MAX_PX], col_c: [-AWAY_MAX_PX, AWAY_MAX_PX], image_height_px: [1, IMAGE_SIDE_MAX], image_width_px: [1, IMAGE_SIDE_MAX],
};
const OF_A_DOME = { skin_radius_mm: [0.1, 1e4], visible_half_angle_deg: [1e-3, 90] }, OF_A_PAD = { visible_radius_mm: [1e-3, 1e4] };
const OF_A_PINHOLE = { camera_distance_mm: [-1e4, 1e6], f_px: [1e-3, 1e6] };

/** The text, cut to at most `most` characters. */
export function cut(text, most = TEXT_MAX) {
  return text.length > most ? `${text.slice(0, most)} … (${text.length} characters)` : text;
}

/** The object in a JSON message, with long parts cut. Throws if it is no object. */
export function read(payload) {
  if (payload.length > BYTES_MAX) throw new Error("the message is too large");
  const value = JSON.parse(new TextDecoder().decode(payload));
  if (value === null || typeof value !== "object" || Array.isArray(value)) throw new Error("not an object");
  return bounded(value);
}

function bounded(value, depth = 0) {
  if (typeof value === "string") return cut(value);
  if (value === null || typeof value !== "object") return value;
  if (depth === DEPTH_MAX) return "…";
  if (Array.isArray(value)) return value.slice(0, ENTRIES_MAX).map((item) => bounded(item, depth + 1));
  const entries = Object.entries(value), kept = entries.slice(0, ENTRIES_MAX).map(([key, item]) => [cut(key, 64), bounded(item, depth + 1)]);
  if (entries.length > ENTRIES_MAX) kept.push(["…", `${entries.length - ENTRIES_MAX} more`]);
  return Object.fromEntries(kept);
}

/** The decoded message, if it contains values called `name` and can be drawn; throws otherwise. */
export function checkDecoded(message, name) {
  if (!(name in message)) throw new Error(`not a message with ${name}`);
  if (name === "points_mm") {
    if (!message.points_mm.every(Number.isFinite)) throw new Error("points that are no place");
    return message;
  }
  const { rows, cols, row0, col0, step_px } = message;
  within({ rows, cols }, { rows: [1, SIDE_MAX], cols: [1, SIDE_MAX] });
  within({ row0, col0, step_px }, { row0: [-AWAY_MAX_PX, AWAY_MAX_PX], col0: [-AWAY_MAX_PX, AWAY_MAX_PX], step_px: [0.01, SIDE_MAX] });
  for (const value of message[name]) if (Math.abs(value) > SCALE_MAX_MM) throw new Error("values that are no depth");
  return message;
}

/** An `info` that the page can use; throws otherwise. A sensor that is not calibrated has no geometry. */
export function checkInfo(info) {
  const { geometry, profiles = [], profile } = info;
  if (!Array.isArray(profiles) || ![profile, ...profiles].every((name) => name === undefined || typeof name === "string")) throw new Error("not profiles");
  if (geometry === null || geometry === undefined) return { ...info, geometry: geometry ?? null };
  within(geometry, GEOMETRY);
  within(geometry, geometry.skin === "pad" ? OF_A_PAD : OF_A_DOME);
  if (geometry.camera_distance_mm !== null) within(geometry, OF_A_PINHOLE);
  const place = info.hand_T_sensor;
  if (place !== null && place !== undefined && !(Array.isArray(place) && place.length === 7 && place.every(Number.isFinite))) throw new Error("not a place in a hand");
  return info;
}

export const checkContact = (contact) => checkNumbers(contact, NUMBERS_OF_CONTACT);

/** An `event/contact`: its times are there, and what else it has are numbers, but for why it ended. */
export function checkEvent(event) {
  const { type, reason_code = "", ...numbers } = event;
  if (![event.id, event.t_ns, event.start_ns].every(Number.isFinite) || (type === "end" && !Number.isFinite(event.end_ns))) throw new Error("not a contact event");
  if (!Object.values(numbers).every((value) => value === null || Number.isFinite(value))) throw new Error("not numbers");
  if (typeof reason_code !== "string") throw new Error("not a reason");
  return event;
}

/** An `event/object`: a name, and how probable it is. */
export function checkObject(event) {
  const { name, probability, label } = event;
  if (typeof name !== "string" || !OBJECT.test(name) || !Number.isFinite(label)) throw new Error("not an object's name");
  within({ probability }, { probability: [0, 1] });
  return event;
}

/** A `touch`: every quantity has its standard deviation; both parts are null without contact. */
export function checkTouch(message) {
  const { seq, touch, touch_sigma, reason = "" } = message;
  if (!Number.isFinite(seq) || typeof reason !== "string") throw new Error("not a touch");
  if (touch === null && touch_sigma === null) return message;
  const names = Object.keys(touch ?? {}), sigma = touch_sigma ?? {};
  if (typeof touch !== "object" || names.length > QUANTITIES_MAX || !names.every((name) => NAME.test(name) && Object.hasOwn(sigma, name))) throw new Error("not a touch");
  for (const name of names) {
    if (touch[name] !== null || sigma[name] !== null) within({ value: touch[name], sigma: sigma[name] }, { value: [-QUANTITY_MAX, QUANTITY_MAX], sigma: [0, QUANTITY_MAX] });
  }
  return message;
}

/** The objects' numbers in a cloud's labels, at most `OBJECTS_MAX` in order, and how many more there are. */
export function objectsIn(labels) {
  const numbers = [...new Set(labels)].sort((a, b) => a - b);
  return { shown: numbers.slice(0, OBJECTS_MAX), more: Math.max(numbers.length - OBJECTS_MAX, 0) };
}

/** A `status/<part>`; the page computes with the numbers of a replay. */
export function checkPart(part) {
  if (typeof part.state !== "string") throw new Error("no state");
  if (part.reason !== undefined && typeof part.reason !== "string") throw new Error("not a reason");
  return checkNumbers(part, NUMBERS_OF_REPLAY);
}

/** A hand's message, decoded by `decodeHand`. */
export function checkHand(message) {
  const fingers = Object.entries(message.fingers);
  if (fingers.length > FINGERS_MAX) throw new Error("too many fingers");
  for (const [name, finger] of fingers) {
    if (!NAME.test(name)) throw new Error("not a finger's name");
    if (!Array.isArray(finger.objects) || finger.objects.length > OBJECTS_MAX) throw new Error("too many objects");
    finger.touched = finger.touched === true;
    finger.reason_code = cut(String(finger.reason_code ?? ""), 64);
    for (const { shear_mm, depth_max_mm, area_mm2 } of finger.objects) {
      if (shear_mm !== null && shear_mm !== undefined && !(Array.isArray(shear_mm) && shear_mm.length === 3 && shear_mm.every(Number.isFinite))) throw new Error("not a shear");
      within({ depth_max_mm, area_mm2 }, { depth_max_mm: [0, SCALE_MAX_MM], area_mm2: [0, SCALE_MAX_MM ** 2] });
    }
  }
  return message;
}

function checkNumbers(value, keys) {
  for (const key of keys) {
    if (value[key] !== null && value[key] !== undefined && !Number.isFinite(value[key])) throw new Error(`not a number: ${key}`);
  }
  return value;
}

function within(value, ranges) {
  for (const [key, [least, most]] of Object.entries(ranges)) {
    if (!(Number.isFinite(value?.[key]) && value[key] >= least && value[key] <= most)) throw new Error(`out of range: ${key}`);
  }
}
