// A hand of several sensors: the fingers' maps side by side, and what they touch in the hand's frame.

import { PIXELS, objectColour, stepOf } from "./colours.js";
import { fitDisc } from "./disc.js";
import { zeroMap } from "./geometry.js";
import { FINGERS_MAX, SENSORS_MAX, checkHand, cut } from "./bounds.js";
import { CONTACT, VALUES } from "./newest.js";
import { UNMEASURED } from "./tiles.js";
import { element, levelOf, number, table } from "./panels.js";
import { AutoScale, drawBar, drawTicks } from "./scale.js";
import { decodeHand } from "./wire.js";

const TOPIC = /^tacshade\/hand\/([^/]+)\/(state|objects)$/;
const STALE_MS = 3000;
const AXES = ["x", "y", "z"], NORMAL_MM = 8, MARGIN_MM = 6;
const SLIPS = ["sticks", "slips in part", "slips"];
const LIGHTS = { contact: "good", touched: "touched", free: "off", away: "bad" }; // the level of a finger's light
const $ = (id) => document.getElementById(id);

export class Whole {
  /** link(): for subscriptions. infos: sensor id -> its info. decoded(payload): null if damaged. changed(): called on news. damaged(): called on an invalid message of a hand. */
  constructor({ link, infos, decoded, changed, damaged }) {
    Object.assign(this, { link, infos, decoded, changed, damaged });
    this.states = new Map(); // hand id -> state
    this.fingers = new Map(); // sensor id -> { canvas, caption, figure, height, map }
    this.shown = null;
    this.message = null;
    this.scale = new AutoScale();
    drawBar($("whole-bar"));
  }

  /** Process a message of a hand; false if it is another message. */
  take(topic, payload) {
    const [, id, what] = TOPIC.exec(topic) ?? [];
    if (id === undefined) return false;
    if (what === "state") {
      if (!payload.length) this.states.delete(id);
      else if (this.states.has(id) || this.states.size < SENSORS_MAX) this.states.set(id, cut(new TextDecoder().decode(payload), 40));
      else this.damaged();
    } else if (id === this.shown) {
      try {
        this.message = checkHand(decodeHand(payload));
      } catch {
        this.damaged();
        return true;
      }
      this.heard_ms = performance.now();
      for (const name of Object.keys(this.message.fingers)) this.follow(name);
      this.changed();
    }
    return true;
  }

  /** Keep a finger's height map, if the finger belongs to the shown hand. */
  takeHeight(sensor, payload) {
    const finger = this.fingers.get(sensor);
    if (!finger) return;
    finger.height = payload;
    this.changed();
  }

  show(id) {
    if (id === this.shown) return;
    this.hide();
    this.shown = id;
    this.message = this.drawn = this.heard_ms = this.body = this.since_ns = null;
    this.fingers = new Map();
    this.shown_ms = performance.now();
    $("whole-maps").replaceChildren();
    $("whole-plane").replaceChildren();
    $("whole-objects").replaceChildren();
    $("whole").hidden = false;
    this.link().subscribe(`tacshade/hand/${id}/objects`);
    this.showState();
  }

  hide() {
    if (this.shown === null) return;
    this.link().unsubscribe(`tacshade/hand/${this.shown}/objects`, ...[...this.fingers.keys()].map((name) => `tacshade/${name}/height`));
    this.shown = null;
    this.fingers = new Map();
    $("whole").hidden = true;
  }

  follow(name) {
    if (this.fingers.has(name) || this.fingers.size >= FINGERS_MAX) return;
    const canvas = element("canvas", { width: 1, height: 1 }), caption = element("figcaption");
    const figure = element("figure", {}, element("a", { href: `#${encodeURIComponent(name)}`, title: `Show ${name} alone` }, canvas), caption);
    this.fingers.set(name, { canvas, caption, figure, height: null, map: null });
    $("whole-maps").append(figure);
    this.link().subscribe(`tacshade/${name}/height`);
  }

  /** Draw what is new. */
  draw() {
    if (this.shown === null || !this.message) return;
    let peak_mm = 0;
    for (const [name, finger] of this.fingers) {
      const geometry = this.infos(name)?.geometry ?? null, { state } = this.message.fingers[name] ?? { state: "away" };
      if (finger.height) finger.map = this.decoded(finger.height, VALUES.height) ?? finger.map;
      finger.height = null;
      const { map } = finger;
      if (state !== "contact" && geometry && (!map || map.flags & CONTACT)) finger.map = zeroMap(geometry); // a release can be lost
      for (const h of finger.map?.height_mm ?? []) if (h > peak_mm) peak_mm = h;
    }
    const scale_mm = this.scale.choose(peak_mm);
    drawTicks($("whole-ticks"), 0, scale_mm);
    for (const [name, finger] of this.fingers) {
      const key = [finger.map, this.infos(name)?.geometry ?? null, scale_mm];
      if (finger.map && !key.every((part, k) => part === finger.painted?.[k])) paint(finger, ...key);
      finger.painted = key;
    }
    this.showState();
    if (this.message !== this.drawn) this.drawObjects();
    this.drawn = this.message;
  }

  /** Show the states in words; old values are grey. */
  showState() {
    if (this.shown === null) return;
    const state = this.states.get(this.shown), works = state === "online" && this.link()?.connected;
    const waits = state === undefined && this.link()?.connected;
    const old_ms = performance.now() - (this.heard_ms ?? this.shown_ms), stale = !works || old_ms > STALE_MS;
    $("whole").classList.toggle("is-stale", stale);
    $("whole-state").dataset.level = works ? levelOf(state) : waits ? "warn" : "bad";
    $("whole-state").textContent = waits ? "No word from this hand yet." : !works ? `This hand is ${state ?? "unknown"}: what you see is old.` : stale ? "This hand publishes nothing: what you see is old." : `${this.shown}: ${state}`;
    for (const [name, { caption, figure, map }] of this.fingers) {
      const { state = "away", touched = false, reason_code = "", objects = [] } = this.message.fingers[name] ?? {}, [greatest] = objects;
      const words = touched ? UNMEASURED : `${state}${reason_code ? `: ${reason_code}` : ""}`;
      const depth = greatest && map?.flags & CONTACT ? `${number(greatest.depth_max_mm, 2)} mm` : words;
      figure.dataset.level = LIGHTS[touched ? "touched" : state];
      const lines = [depth, SLIPS[Math.max(...objects.map(({ slip }) => slip ?? -1))] ?? ""], key = lines.join();
      figure.classList.toggle("is-away", state !== "contact" && state !== "free");
      if (caption.dataset.key !== key) caption.replaceChildren(element("b", {}, element("i", { className: "dot" }), name), ...lines.map((line) => element("span", { textContent: line })));
      caption.dataset.key = key;
    }
  }

  drawObjects() {
    const objects = Object.entries(this.message.fingers).flatMap(([name, { objects }]) => objects.map((touched) => ({ name, ...touched })));
    const place = (v) => v.map((value) => number(value, 1)).join(", ");
    const columns = [
      ["x, y, z mm", (o) => place(o.centroid_mm)], ["normal", (o) => o.normal.map((value) => number(value, 2)).join(", ")],
      ["depth mm", (o) => number(o.depth_max_mm, 2)], ["area mm²", (o) => number(o.area_mm2)], ["shear mm", (o) => (o.shear_mm ? number(Math.hypot(...o.shear_mm), 2) : "")], ["slip", (o) => SLIPS[o.slip] ?? ""],
    ].filter(([, of]) => objects.some((o) => of(o) !== ""));
    $("whole-objects").replaceChildren(table("", objects.map((o) => [o.name, ...columns.map(([, of]) => of(o))]), ["finger", ...columns.map(([head]) => head)]) ?? element("small", { textContent: this.unmeasured() ? UNMEASURED : "no finger touches anything" }));
    this.drawPlane(objects);
  }

  /** Whether something touches a finger, but its depth is unknown. */
  unmeasured() {
    return Object.values(this.message.fingers).some(({ touched }) => touched);
  }

  /** Draw the fingers as named circles and what they touch as one body, in the plane in which the fingers are spread most. */
  drawPlane(objects) {
    const skins = [...this.fingers.keys()].flatMap((name) => {
      const { hand_T_sensor, geometry } = this.infos(name) ?? {};
      return hand_T_sensor ? [{ name, at: hand_T_sensor.slice(0, 3), radius_mm: geometry?.skin_radius_mm ?? geometry?.visible_radius_mm ?? 0 }] : [];
    });
    if (skins.length === 0) return;
    const spread = AXES.map((_, k) => Math.max(...skins.map(({ at }) => at[k])) - Math.min(...skins.map(({ at }) => at[k])));
    const least = spread.lastIndexOf(Math.min(...spread)), [across, up] = [0, 1, 2].filter((k) => k !== least);
    const flat = (v) => [v[across], -v[up]];
    const ends = skins.flatMap(({ at, radius_mm }) => { const [x, y] = flat(at), r = radius_mm + MARGIN_MM; return [[x - r, y - r], [x + r, y + r]]; });
    const [x0, y0, x1, y1] = [Math.min(...ends.map(([x]) => x)), Math.min(...ends.map(([, y]) => y)), Math.max(...ends.map(([x]) => x)), Math.max(...ends.map(([, y]) => y))];
    const moved = this.holdBody(objects);
    const parts = moved ? [outline(this.body.map(flat), "grasped"), outline(this.body.map((p) => flat(moved(p))), "body")] : objects.length > 1 ? [outline(objects.map((o) => flat(o.centroid_mm)), "body")] : [];
    for (const { name, at, radius_mm } of skins) {
      const [x, y] = flat(at), touches = objects.some((o) => o.name === name), { touched } = this.message.fingers[name] ?? {};
      const [kind, about] = touched ? ["skin unmeasured", `${name}: ${UNMEASURED}`] : [touches ? "skin touching" : "skin", name];
      parts.push(shape("circle", { cx: x, cy: y, r: radius_mm, class: kind }, about), shape("text", { x, y, class: "name" }, undefined, name));
    }
    for (const { name, centroid_mm, normal, extent_mm, slip } of objects) {
      const [x, y] = flat(centroid_mm), [dx, dy] = flat(normal), fill = objectColour([...this.fingers.keys()].indexOf(name) + 1);
      const half = Math.max(1.5, Math.hypot(...flat(extent_mm)) / 2), turn = (Math.atan2(dx, -dy) * 180) / Math.PI;
      parts.push(shape("path", { d: `M${x} ${y}l${dx * NORMAL_MM} ${dy * NORMAL_MM}`, class: "normal" }));
      parts.push(shape("ellipse", { cx: 0, cy: 0, rx: half, ry: 1.5, transform: `translate(${x} ${y}) rotate(${turn})`, fill, class: slip === 2 ? "patch slips" : "patch" }, `${name}${SLIPS[slip] ? `: ${SLIPS[slip]}` : ""}`));
      parts.push(shape("circle", { cx: x, cy: y, r: 1, fill, class: "touched" }, name));
    }
    const plane = $("whole-plane");
    plane.setAttribute("viewBox", `${x0} ${y0} ${x1 - x0} ${y1 - y0}`);
    plane.replaceChildren(...parts);
    $("whole-axes").textContent = `${AXES[across]} to the right, ${AXES[up]} upwards, ${Math.round(x1 - x0)} mm wide${moved ? `; since it was grasped moved by ${number(moved.by_mm, 1)} mm, turned by ${number(moved.by_deg, 1)}°` : ""}`;
  }

  /** Keep the patches of a held body at their places when it was grasped; return its motion since, or null if unknown. */
  holdBody(objects) {
    const held = objects.filter(({ motion }) => motion && [motion.translation_mm, motion.rotation_deg].every((v) => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite)));
    if (held.length < 2) return (this.body = this.since_ns = null);
    const { motion } = held[0], moved = motionOf(motion);
    if (motion.since_ns !== this.since_ns || held.length > this.body.length) this.body = held.map((o) => moved.back(o.centroid_mm));
    this.since_ns = motion.since_ns;
    return moved;
  }
}

/** A motion in the hand's message as a function of points, with its inverse as `back`: Rodrigues' rotation about a point, then a translation. */
function motionOf({ translation_mm, rotation_deg, about_mm = [0, 0, 0] }) {
  const vector = rotation_deg.map((v) => (v * Math.PI) / 180), angle = Math.hypot(...vector), axis = vector.map((v) => v / (angle || 1));
  const turned = (p, by) => {
    const along = axis.reduce((sum, v, k) => sum + v * p[k], 0) * (1 - Math.cos(by));
    const beside = [0, 1, 2].map((k) => axis[(k + 1) % 3] * p[(k + 2) % 3] - axis[(k + 2) % 3] * p[(k + 1) % 3]);
    return p.map((v, k) => v * Math.cos(by) + beside[k] * Math.sin(by) + axis[k] * along);
  };
  const moved = (p) => turned(p.map((v, k) => v - about_mm[k]), angle).map((v, k) => v + about_mm[k] + translation_mm[k]);
  Object.assign(moved, { by_mm: Math.hypot(...translation_mm), by_deg: Math.hypot(...rotation_deg) });
  moved.back = (p) => turned(p.map((v, k) => v - about_mm[k] - translation_mm[k]), -angle).map((v, k) => v + about_mm[k]);
  return moved;
}

/** The convex hull of points (Andrew's monotone chain). */
function outline(points, kind) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const chain = (all) => all.reduce((kept, p) => {
    while (kept.length > 1 && cross(kept.at(-2), kept.at(-1), p) <= 0) kept.pop();
    return [...kept, p];
  }, []);
  const corners = [...chain(sorted).slice(0, -1), ...chain(sorted.toReversed()).slice(0, -1)];
  return shape("polygon", { points: corners.map((p) => p.join(",")).join(" "), class: kind });
}

function cross([ax, ay], [bx, by], [cx, cy]) {
  return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
}

/** Draw a finger's map on its canvas, clipped to the visible disc. */
function paint(finger, map, geometry, scale_mm) {
  const { canvas } = finger, grid = [map.rows, map.cols, map.row0, map.col0, map.step_px, geometry?.calibration_crc32, geometry?.radius_px].join();
  if (grid !== finger.grid) {
    Object.assign(finger, { grid, disc: fitDisc(map, geometry) });
    [canvas.width, canvas.height] = [finger.disc.cols, finger.disc.rows];
    canvas.style.clipPath = finger.disc.clip;
  }
  const { rows, cols, source } = finger.disc, context = canvas.getContext("2d", { willReadFrequently: true }), image = context.createImageData(cols, rows), pixels = new Uint32Array(image.data.buffer);
  for (let at = 0; at < source.length; at++) {
    const h = map.height_mm[source[at]];
    pixels[at] = h !== h ? 0 : PIXELS[stepOf(h, scale_mm)];
  }
  context.putImageData(image, 0, 0);
}

function shape(name, attributes, title, text = "") {
  const made = document.createElementNS($("whole-plane").namespaceURI, name);
  made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (title !== undefined) {
    const tooltip = document.createElementNS($("whole-plane").namespaceURI, "title");
    tooltip.textContent = title;
    made.append(tooltip);
  }
  return made;
}
