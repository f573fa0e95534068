// The scale under a picture in mm.

import { PIXELS, STEPS } from "./colours.js";

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
