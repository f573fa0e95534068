// Compare the chosen sensor with another one or with a held moment of its own: both maps on one scale, and their difference.

import { DIFFERENCES, PIXELS, STEPS, stepOf } from "./colours.js";
import { heightAt, rimOf } from "./geometry.js";
import { checkContact, checkPart } from "./bounds.js";
import { contactOfMap, keepContact, nextMap } from "./newest.js";
import { number, table } from "./panels.js";
import { isPaused, isPlayed, justBefore, showAgain } from "./playback.js";
import { AutoScale, drawBar, drawTicks } from "./scale.js";

const STREAMS = ["height", "contact", "status/replay", "res/replay"];
const NICE_MM = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 40];
const MOMENT = "#moment"; // not a valid sensor name
const SAME_PX = 2, SAME_MM = 0.1;
const $ = (id) => document.getElementById(id);

export class Compare {
  /** link(): for subscriptions and requests. decoded(payload, values): null if damaged. changed(): called on news. readOnly: send no requests. */
  constructor({ link, decoded, changed, readOnly }) {
    this.link = link;
    this.readOnly = readOnly;
    this.decoded = decoded;
    this.changed = changed;
    this.sensor = null;
    this.held = null; // the held moment: name, info and state
    this.seen = null; // figures of the difference on screen
    drawBar($("compare-bar"));
    drawBar($("difference-bar"), DIFFERENCES);
    $("against").addEventListener("change", () => {
      if ($("against").value === MOMENT) this.hold();
      else this.choose($("against").value || null);
      changed();
    });
  }

  /** Offer these sensors for comparison. */
  offer(names) {
    if (this.sensor !== null && !names.includes(this.sensor)) this.choose(null);
    const key = names.join();
    if (key !== this.offered) $("against").replaceChildren(new Option("nothing", ""), new Option("this moment", MOMENT), ...names.map((name) => new Option(name, name)));
    this.offered = key;
    $("against").value = this.held ? MOMENT : this.sensor ?? "";
  }

  /** Hold what is shown of the chosen sensor now, to compare later maps with it. */
  hold() {
    const { name, view, info } = this.first ?? {};
    this.choose(null);
    if (!view?.map) return void ($("against").value = "");
    const numbers = contactOfMap(view);
    this.held = { name: `${name}, ${new Date().toLocaleTimeString()}`, info, state: "online" };
    this.view = { ...emptyView(), map: view.map, contact: numbers, contacts: new Map(numbers ? [[view.map.seq, numbers]] : []), drawnFor: info?.geometry ?? null };
    this.scale = new AutoScale();
    this.drawn = null;
    $("compare").hidden = false;
    $("against").value = MOMENT;
  }

  choose(sensor) {
    if (sensor === this.sensor && !this.held) return;
    const topics = (name) => STREAMS.map((stream) => `tacshade/${name}/${stream}`);
    if (this.sensor !== null) this.link().unsubscribe(...topics(this.sensor));
    this.sensor = sensor;
    this.held = null;
    this.view = emptyView();
    this.scale = new AutoScale();
    this.seen = this.drawn = null;
    $("compare").hidden = sensor === null;
    $("compare-maps").hidden = true;
    $("compare-words").textContent = "it has published nothing yet";
    $("compare-numbers").replaceChildren();
    if (sensor !== null) this.link().subscribe(...topics(sensor));
  }

  take(what, payload, json) {
    if (what === "height") {
      this.view.height = payload;
      this.view.height_ms = performance.now();
    } else if (what === "contact") json(payload, (contact) => keepContact(this.view, contact), checkContact);
    else if (what === "status/replay") {
      json(payload, (status) => {
        this.view.parts.set("replay", status);
        const report = (error) => { $("compare-words").textContent = `${this.sensor} is paused: ${error.message}`; };
        if (!this.readOnly) showAgain(this.link(), this.sensor, this.view).catch(report);
        else if (isPaused(this.view.parts) && !this.view.map) report(new Error("its picture appears once it plays."));
      }, checkPart);
    } else return;
    this.changed();
  }

  /** Send the other recording the same request as the chosen one; a pause stops both at the same position. */
  follow(body, { position_s }) {
    if (this.sensor === null || !isPlayed(this.view.parts)) return;
    const pause = body.paused === true ? { seek_s: justBefore(position_s) } : {};
    this.link().request(this.sensor, "replay", { ...body, ...pause }).catch((error) => {
      $("compare-words").textContent = `${this.sensor}: ${error.message}`;
    });
  }

  /** Draw. first: name, view and info of the chosen sensor. sensor: info and state of the other. heights: the view of the chosen sensor's map. */
  draw(first, sensor, heights) {
    this.first = first;
    if (this.sensor === null && !this.held) return;
    const { view } = this, other = this.held ?? { name: this.sensor, ...sensor }, geometry = other.info?.geometry ?? null;
    const map = this.held ? null : nextMap(view, geometry, this.decoded);
    if (map) {
      view.map = map;
      view.shown_ms = performance.now();
      view.drawnFor = geometry;
    }
    const key = [first.view.map, view.map, contactOfMap(first.view), contactOfMap(view), heights.fixed_mm];
    if (!first.view.map || !view.map || (this.drawn && key.every((part, k) => part === this.drawn[k]))) return;
    this.drawn = key;
    $("compare-maps").hidden = !isSame(first.info?.geometry, geometry);
    if ($("compare-maps").hidden) {
      this.seen = null;
      $("compare-words").textContent = `${other.name} has another camera or skin, so its cells are not those of ${first.name}`;
    } else this.paint(first.view.map, heights.crop, heights.fixed_mm);
    $("first-name").textContent = first.name;
    $("other-name").textContent = ["online", "degraded"].includes(other.state) ? other.name : `${other.name} (${other.state ?? "unknown"})`;
    this.names = this.held ? ["now", "before"] : [first.name, other.name];
    $("difference-name").textContent = this.names.join(" less ");
    this.showNumbers(first, other);
  }

  /** Draw both maps in the cells of the first, on one scale that covers the deeper one unless it is fixed, and the first less the other. */
  paint(map, { top, left, rows, cols, source, clip }, fixed_mm) {
    const count = rows * cols, others = new Float32Array(count);
    const pictures = ["first", "other", "difference"].map((name) => {
      const canvas = $(`${name}-cells`);
      if (canvas.width !== cols) canvas.width = cols;
      if (canvas.height !== rows) canvas.height = rows;
      canvas.style.clipPath = clip;
      const context = canvas.getContext("2d"), image = context.createImageData(cols, rows);
      return { context, image, pixels: new Uint32Array(image.data.buffer) };
    });
    const [first, other, apart] = pictures;
    let cells = 0, sum_mm = 0, worst_mm = 0, worst_at = 0, peak_mm = 0;
    for (let at = 0; at < count; at++) {
      const a = map.height_mm[source[at]], i = Math.floor(source[at] / map.cols), j = source[at] % map.cols;
      if (a !== a) continue;
      const b = others[at] = heightAt(this.view.map, map.row0 + i * map.step_px, map.col0 + j * map.step_px);
      for (const h of [a, b]) if (h > peak_mm) peak_mm = h;
      if (i - top !== Math.floor(at / cols) || j - left !== at % cols) continue; // a rim cell: the cell next to it is counted
      cells++;
      sum_mm += Math.abs(b - a);
      if (Math.abs(b - a) > Math.abs(worst_mm)) {
        worst_mm = a - b;
        worst_at = source[at];
      }
    }
    const scale_mm = fixed_mm ?? this.scale.choose(peak_mm);
    const end_mm = NICE_MM.find((nice) => nice >= Math.abs(worst_mm)) ?? NICE_MM.at(-1);
    for (let at = 0; at < count; at++) {
      const a = map.height_mm[source[at]];
      if (a !== a) continue;
      first.pixels[at] = PIXELS[stepOf(a, scale_mm)];
      other.pixels[at] = PIXELS[stepOf(others[at], scale_mm)];
      apart.pixels[at] = DIFFERENCES[stepOf(a - others[at] + end_mm, 2 * end_mm)];
    }
    for (const { context, image } of pictures) context.putImageData(image, 0, 0);
    drawTicks($("compare-ticks"), 0, scale_mm);
    drawTicks($("difference-ticks"), -end_mm, end_mm);
    const row = map.row0 + Math.floor(worst_at / map.cols) * map.step_px, col = map.col0 + (worst_at % map.cols) * map.step_px;
    this.seen = { mean_mm: sum_mm / Math.max(cells, 1), worst_mm, row, col };
    $("compare-words").textContent = `heights are ${number(this.seen.mean_mm, 3)} mm apart on average, ${signed(worst_mm, 3)} mm at worst, at row ${number(row)}, col ${number(col)} px`;
  }

  showNumbers(first, other) {
    const a = contactOfMap(first.view), b = contactOfMap(this.view);
    const numbers = [["greatest depth, mm", "depth_max_mm", 2], ["area, mm²", "area_mm2", 1], ["volume, mm³", "volume_mm3", 1], ["objects", "objects", 0]];
    const rows = numbers.map(([name, key, digits]) => [name, number(a?.[key], digits), number(b?.[key], digits), a && b ? signed(a[key] - b[key], digits) : ""]);
    rows.unshift(["profile", first.info?.profile ?? "", other.info?.profile ?? "", ""], ["frame", number(a?.seq ?? first.view.map.seq), number(b?.seq ?? this.view.map.seq), ""]);
    $("compare-numbers").replaceChildren(table("", rows, ["", ...this.names, "difference"]) ?? "");
  }
}

const signed = (value, digits) => `${value > 0 ? "+" : ""}${number(value, digits)}`;

const emptyView = () => ({ height: null, contact: null, contacts: new Map(), numbers: null, map: null, height_ms: 0, shown_ms: 0, drawnFor: null, parts: new Map() });

/** Whether two sensors see the same skin through the same camera, within the differences between two calibrations. */
function isSame(a, b) {
  if (!a || !b) return false;
  const near = (key, most) => Math.abs(a[key] - b[key]) <= most;
  return near("image_height_px", 0) && near("image_width_px", 0) && near("row_c", SAME_PX) && near("col_c", SAME_PX) && near("radius_px", SAME_PX) && near("skin_radius_mm", SAME_MM) && Math.abs(rimOf(a).rim - rimOf(b).rim) <= SAME_MM;
}
