// The height map on its canvas: one canvas pixel per cell, clipped to the visible disc.

import { PIXELS, STEPS, depthOf } from "./colours.js";
import { fitDisc } from "./disc.js";
import { skinPoint } from "./geometry.js";
import { drawDoubts } from "./marks.js";
import { AutoScale, drawBar, drawTicks } from "./scale.js";

export class HeightView {
  constructor() {
    this.canvas = document.getElementById("cells");
    this.context = this.canvas.getContext("2d", { willReadFrequently: true });
    this.overlay = document.getElementById("overlay");
    this.disc = document.getElementById("disc");
    this.doubts = document.getElementById("doubts");
    this.readout = document.getElementById("cursor");
    this.ticks = document.getElementById("ticks");
    this.range = document.getElementById("range");
    this.auto = new AutoScale();
    this.scale_mm = this.auto.mm;
    this.map = null;
    this.sigma = null; // the newest, which belongs to this map or an earlier one
    this.geometry = null;
    this.cell = null; // under the pointer: [i, j] in the map
    drawBar(document.getElementById("bar"));
    drawTicks(this.ticks, 0, this.scale_mm);
    this.canvas.addEventListener("pointermove", (event) => this.point(event));
    this.canvas.addEventListener("pointerdown", (event) => this.point(event));
    this.canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") this.cell = null;
      this.read();
    });
    this.canvas.addEventListener("keydown", (event) => this.walk(event));
  }

  /** Forget another sensor's map. */
  clear() {
    this.map = this.sigma = this.geometry = this.cell = null;
    this.auto = new AutoScale();
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.disc.setAttribute("r", 0);
    drawDoubts(this.doubts, null, null, null);
    this.read();
  }

  /** Draw a decoded height map; geometry may be null until info arrives. */
  draw(map, geometry) {
    this.map = map;
    this.geometry = geometry;
    this.fit();
    const { source } = this.crop, { height_mm } = map, count = source.length;
    let peak_mm = 0;
    for (let at = 0; at < count; at++) {
      const h = height_mm[source[at]];
      if (h > peak_mm) peak_mm = h;
    }
    this.choose(peak_mm);
    const factor = (STEPS - 1) / this.scale_mm, pixels = this.pixels;
    for (let at = 0; at < count; at++) {
      const h = height_mm[source[at]];
      // NaN, outside the disc, is transparent.
      pixels[at] = h !== h ? 0 : h <= 0 ? PIXELS[0] : PIXELS[Math.min(STEPS - 1, Math.round(h * factor))];
    }
    this.context.putImageData(this.image, 0, 0);
    this.read();
  }

  /** Set the shown part of the map, and fit the canvas and the outline to it. */
  fit() {
    const { map, geometry } = this;
    const key = [map.rows, map.cols, map.row0, map.col0, map.step_px, geometry?.calibration_crc32, geometry?.radius_px].join();
    if (key === this.key && this.canvas.width === this.crop.cols) return;
    this.key = key;
    this.crop = fitDisc(map, geometry);
    const { top, left, rows, cols, clip } = this.crop;
    this.canvas.style.clipPath = clip;
    this.canvas.width = cols;
    this.canvas.height = rows;
    this.image = this.context.createImageData(cols, rows);
    this.pixels = new Uint32Array(this.image.data.buffer);
    // The outline in units of image pixels; a cell is centred on its pixel.
    const x = map.col0 + (left - 0.5) * map.step_px, y = map.row0 + (top - 0.5) * map.step_px;
    this.overlay.setAttribute("viewBox", `${x} ${y} ${cols * map.step_px} ${rows * map.step_px}`);
    this.disc.setAttribute("cx", geometry?.col_c ?? 0);
    this.disc.setAttribute("cy", geometry?.row_c ?? 0);
    this.disc.setAttribute("r", geometry?.radius_px ?? 0);
  }

  /** The scale in mm that the user set; null if it follows the maps. */
  get fixed_mm() {
    return this.range.value === "auto" ? null : Number(this.range.value);
  }

  /** Set the scale: the user's, or the least round number that covers the greatest depth of the last seconds. */
  choose(peak_mm) {
    const scale_mm = this.fixed_mm ?? this.auto.choose(peak_mm);
    if (scale_mm === this.scale_mm) return;
    this.scale_mm = scale_mm;
    drawTicks(this.ticks, 0, this.scale_mm);
  }

  point(event) {
    if (!this.map) return;
    const box = this.canvas.getBoundingClientRect();
    const i = Math.floor(((event.clientY - box.top) / box.height) * this.crop.rows);
    const j = Math.floor(((event.clientX - box.left) / box.width) * this.crop.cols);
    this.cell = [i + this.crop.top, j + this.crop.left];
    this.read();
  }

  /** Arrow keys read the map cell by cell, from the middle of the disc. */
  walk(event) {
    const step = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    if (!step || !this.map) return;
    event.preventDefault();
    const { top, left, rows, cols } = this.crop, [i, j] = this.cell ?? [top + Math.floor(rows / 2), left + Math.floor(cols / 2)];
    this.cell = [Math.min(Math.max(i + step[0], top), top + rows - 1), Math.min(Math.max(j + step[1], left), left + cols - 1)];
    this.read();
  }

  /** Keep the decoded `sigma` of this map; null if it has none. */
  setSigma(sigma) {
    this.sigma = sigma;
    drawDoubts(this.doubts, this.map, sigma, this.geometry);
    this.read();
  }

  /** Show the depth under the pointer, and its standard deviation where the skin is touched. */
  read() {
    const { map, geometry, cell } = this;
    if (!map || !cell) {
      this.readout.textContent = "Point at the map to read a depth.";
      return;
    }
    const [i, j] = cell, h = i < map.rows && j < map.cols ? map.height_mm[i * map.cols + j] : NaN;
    const row = map.row0 + i * map.step_px, col = map.col0 + j * map.step_px;
    const px = `row ${row.toFixed(0)}, col ${col.toFixed(0)} px`;
    if (Number.isNaN(h)) {
      this.readout.textContent = `outside the skin · ${px}`;
      return;
    }
    const at = [0, 0, 0];
    if (geometry) skinPoint(geometry, row, col, h, at, 0);
    const mm = geometry ? ` · x ${at[0].toFixed(1)}, y ${at[1].toFixed(1)} mm` : "";
    this.readout.innerHTML = "";
    const depth = document.createElement("b");
    const sigma = this.sigma?.rows === map.rows && this.sigma.cols === map.cols ? this.sigma.sigma_mm[i * map.cols + j] : NaN;
    depth.textContent = Number.isNaN(sigma) ? `${h.toFixed(3)} mm` : `${h.toFixed(3)} ± ${sigma.toFixed(2)} mm`;
    this.readout.append(depth, `${mm} · ${px}`);
  }

  /** Depth in mm that the canvas shows at an image pixel, from its colour; NaN if it shows none. */
  depthAt(row, col) {
    const { map, crop, geometry } = this;
    if (!map || (geometry && Math.hypot(row - geometry.row_c, col - geometry.col_c) > geometry.radius_px)) return NaN;
    const i = Math.round((row - map.row0) / map.step_px) - crop.top, j = Math.round((col - map.col0) / map.step_px) - crop.left;
    if (i < 0 || j < 0 || i >= crop.rows || j >= crop.cols) return NaN;
    const [red, green, blue, alpha] = this.context.getImageData(j, i, 1, 1).data;
    return alpha === 0 ? NaN : depthOf(red, green, blue, this.scale_mm);
  }

  /** Greatest depth in mm that the canvas shows, from its colours. */
  drawnPeak() {
    const { data } = this.context.getImageData(0, 0, this.canvas.width, this.canvas.height);
    let peak_mm = NaN;
    for (let at = 0; at < data.length; at += 4) {
      if (data[at + 3] === 0) continue;
      const mm = depthOf(data[at], data[at + 1], data[at + 2], this.scale_mm);
      if (!(mm <= peak_mm)) peak_mm = mm;
    }
    return peak_mm;
  }
}
