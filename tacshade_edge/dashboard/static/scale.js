// The scale under a picture in mm.

import { PIXELS, STEPS } from "./colours.js";

const AUTO_LEAST_MM = 0.5;
const NICE_MM = [0.5, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15, 20, 40];
const AUTO_KEEPS_MS = 8000;

/** The least round number that holds the deepest of the last seconds. */
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

/** Every colour, once. */
export function drawBar(canvas, pixels = PIXELS) {
  const context = canvas.getContext("2d"), image = context.createImageData(STEPS, 1);
  new Uint32Array(image.data.buffer).set(pixels);
  context.putImageData(image, 0, 0);
}

/** Five numbers from one end to the other. */
export function drawTicks(list, low_mm, high_mm) {
  const parts = [0, 1, 2, 3, 4].map((k) => {
    const tick = document.createElement("li");
    tick.textContent = `${+(low_mm + ((high_mm - low_mm) * k) / 4).toFixed(3)}${k === 4 ? " mm" : ""}`;
    return tick;
  });
  list.replaceChildren(...parts);
}
