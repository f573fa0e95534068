// The touch as a few numbers, each with an interval of one standard deviation. The sensor computes it only while
// somebody subscribes, so this page subscribes only while the panel is visible.

import { cut } from "./bounds.js";
import { element, number } from "./panels.js";

const UNITS = new Map([["mm", ["mm", 2]], ["deg", ["°", 1]], ["n", ["N", 2]], ["nmm", ["N·mm", 1]]]); // symbol and digits
const FREE = "nothing touches";
const $ = (id) => document.getElementById(id);

export class TouchPanel {
  /** link(): for subscriptions. */
  constructor({ link }) {
    Object.assign(this, { link, sensor: null, topic: null, visible: false });
    this.clear();
    new IntersectionObserver((entries) => {
      this.visible = entries.at(-1).isIntersecting;
      this.follow();
    }).observe($("touch"));
    document.addEventListener("visibilitychange", () => this.follow());
  }

  /** Show another sensor; null for none. */
  choose(sensor) {
    this.sensor = sensor;
    this.clear();
    this.follow();
  }

  clear() {
    this.rows = new Map(); // name -> what `makeRow` gives
    this.drawn = null;
    $("touch-numbers").replaceChildren();
    $("touch").classList.add("is-empty");
  }

  follow() {
    const topic = this.sensor !== null && this.visible && !document.hidden ? `tacshade/${this.sensor}/touch` : null;
    if (topic === this.topic) return;
    if (this.topic !== null) this.link().unsubscribe(this.topic);
    if (topic !== null) this.link().subscribe(topic);
    this.topic = topic;
  }

  /** Draw the message of the shown map; null if none arrived. */
  draw(message) {
    if (message === this.drawn) return;
    this.drawn = message;
    const { touch, touch_sigma, reason } = message ?? {};
    const words = reason || (message && !touch ? FREE : "");
    $("touch-numbers").classList.toggle("is-free", !touch);
    $("touch-words").textContent = words;
    const names = Object.keys(touch ?? {});
    if (touch && (names.length !== this.rows.size || !names.every((name) => this.rows.has(name)))) {
      this.rows = new Map(names.map((name) => [name, makeRow(name)]));
      $("touch-numbers").replaceChildren(...[...this.rows.values()].map(({ row }) => row));
    }
    $("touch").classList.toggle("is-empty", this.rows.size === 0 && !reason);
    for (const [name, row] of this.rows) showRow(row, touch?.[name] ?? null, touch_sigma?.[name] ?? 0, words || "not known");
  }
}

function makeRow(name) {
  const [, words, unit] = /^(.*?)_?([^_]*)$/.exec(name), [symbol, digits] = UNITS.get(unit) ?? ["", 2];
  const value = element("output"), more = element("span"), interval = element("i");
  const row = element("div", {}, element("dt", { textContent: cut((UNITS.has(unit) ? words : name).replaceAll("_", " "), 40) }), element("dd", {}, value, more), element("div", { className: "interval", ariaHidden: "true" }, interval));
  return { row, value, more, interval, symbol, digits, end: 0 };
}

/** Show a value: the bar's middle is 0, its ends are the least 1, 2 or 5 times a power of ten that has covered every value so far. */
function showRow(shown, value, sigma, why) {
  const { row, digits, symbol } = shown, known = value !== null;
  shown.value.textContent = known ? number(value, digits) : "";
  shown.more.textContent = known ? ` ± ${number(sigma, digits)} ${symbol}` : "not known";
  shown.interval.hidden = !known;
  shown.end = Math.max(shown.end, known ? roundUp(Math.abs(value) + sigma) : 0);
  row.title = known ? `One standard deviation; the bar is from −${shown.end} to ${shown.end} ${symbol}` : why;
  if (!known) return;
  shown.interval.style.left = `${50 + (50 * (value - sigma)) / shown.end}%`;
  shown.interval.style.width = `${(100 * sigma) / shown.end}%`;
}

function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 0.01)));
  return +(power * [1, 2, 5, 10].find((nice) => nice * power >= value * (1 - 1e-9))).toPrecision(1);
}
