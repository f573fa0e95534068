// The scale in mm under a picture.

import { PIXELS, STEPS } from "./colours.js";

const AUTO_LEAST_MM = 0.5;
const NICE_MM = [0.5, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15, 20, 40];
const AUTO_KEEPS_MS = 8000;
const TICKS_MOST = 6;

/** A scale that is the least round number that covers the greatest depth of the last seconds. */
export class AutoScale {
  constructor() {
    this.mm = AUTO_LEAST_MM;
    this.peaks = []; // [time, mm]
  }

  choose(peak_mm) {
    const now = performance.now();
    this.peaks = this.peaks.filter(([time, mm]) => now - time < AUTO_KEEPS_MS && mm > peak_mm);
    this.peaks.push([now, peak_mm]);
    this.mm = NICE_MM.find((nice) => nice >= this.peaks[0][1]) ?? NICE_MM.at(-1);
    return this.mm;
  }
}

/** Draw every colour once. */
export function drawBar(canvas, pixels = PIXELS) {
  const context = canvas.getContext("2d"), image = context.createImageData(STEPS, 1);
  new Uint32Array(image.data.buffer).set(pixels);
  context.putImageData(image, 0, 0);
}

/** The round numbers between two ends, in steps of 1, 2 or 5 times a power of ten. */
export function roundTicks(low, high) {
  const least = (high - low) / (TICKS_MOST - 1), power = 10 ** Math.floor(Math.log10(least) + 1e-9);
  const step = [1, 2, 5, 10].map((n) => n * power).find((apart) => apart >= least * (1 - 1e-9));
  const first = Math.ceil(low / step - 1e-9), count = Math.floor(high / step + 1e-9) - first + 1;
  return Array.from({ length: count }, (_, k) => +((first + k) * step).toPrecision(12));
}

/** Show the round numbers at their places on the bar; the last one has the unit. */
export function drawTicks(list, low_mm, high_mm) {
  const key = `${low_mm} ${high_mm}`;
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  const ticks = roundTicks(low_mm, high_mm);
  list.replaceChildren(...ticks.map((mm, k) => {
    const tick = document.createElement("li");
    tick.style.left = `${(100 * (mm - low_mm)) / (high_mm - low_mm)}%`;
    tick.textContent = `${mm}${k === ticks.length - 1 ? " mm" : ""}`.replace("-", "−");
    return tick;
  }));
}
