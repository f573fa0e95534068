// The stitched map from above, in the robot's base frame: x to the right, y upwards, coloured by z.

import { PIXELS, STEPS, depthOf } from "./colours.js";
import { element, number } from "./panels.js";
import { drawBar, drawTicks } from "./scale.js";

const MOST_PX = 1024; // a sparse map may span a metre in cells of 0.25 mm
const MOST_LINES = 12;

export class MapView {
  constructor() {
    this.section = document.getElementById("stitched");
    this.canvas = document.getElementById("stitched-cells");
    this.context = this.canvas.getContext("2d", { willReadFrequently: true });
    this.lines = document.getElementById("stitched-lines");
    this.readout = document.getElementById("stitched-cursor");
    drawBar(document.getElementById("stitched-bar"));
    this.canvas.addEventListener("pointermove", (event) => this.point(event));
    this.canvas.addEventListener("pointerdown", (event) => this.point(event));
    this.canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") this.at_mm = null;
      this.read();
    });
    this.clear();
  }

  /** Forget another sensor's map. */
  clear() {
    this.section.hidden = true;
    this.about = this.cloud = this.at_mm = null;
  }

  /**
   * Draw a revision: `about` from `map/revision` or `map/final`, and the decoded `map/cloud` that belongs to it.
   * Throws if `about` has no valid extent for the points.
   */
  draw(about, cloud) {
    const { x0_mm, y0_mm, width_mm, length_mm, spacing_mm } = about;
    const cell_mm = Math.max(spacing_mm, width_mm / MOST_PX, length_mm / MOST_PX);
    if (!(Number.isFinite(x0_mm) && Number.isFinite(y0_mm) && spacing_mm > 0 && Math.min(width_mm, length_mm) > 0 && cell_mm < Infinity)) {
      throw new Error("not the extent of a map");
    }
    const cols = Math.ceil(width_mm / cell_mm - 1e-6), rows = Math.ceil(length_mm / cell_mm - 1e-6);
    const { points_mm } = cloud, z_mm = new Float32Array(rows * cols).fill(NaN);
    let low = Infinity, high = -Infinity;
    for (let k = 0; k < points_mm.length; k += 3) {
      const j = Math.round((points_mm[k] - x0_mm) / cell_mm), i = Math.round((points_mm[k + 1] - y0_mm) / cell_mm), z = points_mm[k + 2];
      if (!(i >= 0 && j >= 0 && i < rows && j < cols)) continue;
      z_mm[(rows - 1 - i) * cols + j] = z; // y upwards
      if (z < low) low = z;
      if (z > high) high = z;
    }
    Object.assign(this, { about, cloud, cell_mm, rows, cols, z_mm });
    // Rounded to quarters of a millimetre, so that not every press changes the colours.
    this.low_mm = low <= high ? Math.floor(4 * low) / 4 : 0;
    this.high_mm = Math.max(this.low_mm + 0.5, Math.ceil(4 * high) / 4);
    this.paint();
    this.drawLines();
    this.showNumbers();
    this.read();
    this.section.hidden = false;
  }

  paint() {
    const { canvas, context, rows, cols, z_mm, low_mm } = this, factor = (STEPS - 1) / (this.high_mm - low_mm);
    const image = context.createImageData(cols, rows), pixels = new Uint32Array(image.data.buffer);
    for (let at = 0; at < z_mm.length; at++) {
      const z = z_mm[at];
      if (z === z) pixels[at] = PIXELS[Math.round((z - low_mm) * factor)]; // untouched is transparent
    }
    // A new size clears the canvas; the browser shows nothing before the new picture.
    if (canvas.width !== cols || canvas.height !== rows) [canvas.width, canvas.height] = [cols, rows];
    context.putImageData(image, 0, 0);
    drawTicks(document.getElementById("stitched-ticks"), low_mm, this.high_mm);
  }

  /** Draw lines at round coordinates of the base frame. */
  drawLines() {
    const { about, cell_mm, cols, rows } = this, width = cols * cell_mm, length = rows * cell_mm;
    const left = about.x0_mm - cell_mm / 2, bottom = about.y0_mm - cell_mm / 2; // a cell is centred on its point
    const least_mm = Math.max(width, length) / MOST_LINES, power = 10 ** Math.floor(Math.log10(least_mm));
    this.apart_mm = Math.max(1, [1, 2, 5, 10].map((n) => n * power).find((mm) => mm >= least_mm));
    const places = (from, size) => {
      const first = Math.ceil(from / this.apart_mm) * this.apart_mm, count = Math.max(0, Math.floor((from + size - first) / this.apart_mm) + 1);
      return Array.from({ length: count }, (_, k) => first + k * this.apart_mm - from);
    };
    this.lines.parentElement.setAttribute("viewBox", `0 0 ${width} ${length}`);
    const across = places(left, width).map((x) => `M${x} 0V${length}`), along = places(bottom, length).map((y) => `M0 ${length - y}H${width}`);
    this.lines.setAttribute("d", [`M0 0H${width}V${length}H0Z`, ...across, ...along].join(""));
  }

  showNumbers() {
    const { name, presses, used, revision, width_mm, length_mm, area_mm2, spacing_mm, folder } = this.about;
    const when = new Date(Number(this.cloud.wall_ns / 1000000n)).toLocaleString();
    document.getElementById("stitched-name").textContent = `${name}, ${folder ? "final" : "growing"}`;
    const facts = [
      ["presses", used < presses ? `${presses}, ${presses - used} left out` : presses], ["revision", revision],
      ["size", `${number(width_mm, 1)} × ${number(length_mm, 1)} mm`], ["touched", `${number(area_mm2)} mm²`],
      ["points", `${number(spacing_mm, 2)} mm apart`], ["lines", `${this.apart_mm} mm apart`], ["at", when],
      ...(folder ? [["files", folder]] : []),
    ];
    document.getElementById("stitched-facts").replaceChildren(
      ...facts.map(([term, fact]) => element("div", {}, element("dt", { textContent: term }), element("dd", { textContent: fact }))),
    );
  }

  point(event) {
    if (!this.about) return;
    // The picture in its frame, as object-fit: contain places it.
    const box = this.canvas.getBoundingClientRect(), scale = Math.min(box.width / this.cols, box.height / this.rows);
    const j = (event.clientX - (box.left + box.right) / 2) / scale + this.cols / 2;
    const i = (event.clientY - (box.top + box.bottom) / 2) / scale + this.rows / 2;
    const { x0_mm, y0_mm } = this.about;
    // In mm, not in cells: the map may grow under a resting pointer.
    this.at_mm = [x0_mm + (j - 0.5) * this.cell_mm, y0_mm + (this.rows - i - 0.5) * this.cell_mm];
    this.read();
  }

  cellOf(x_mm, y_mm) {
    const j = Math.round((x_mm - this.about.x0_mm) / this.cell_mm), i = this.rows - 1 - Math.round((y_mm - this.about.y0_mm) / this.cell_mm);
    return i >= 0 && j >= 0 && i < this.rows && j < this.cols ? [i, j] : null;
  }

  /** Show z under the pointer. */
  read() {
    const cell = this.about && this.at_mm ? this.cellOf(...this.at_mm) : null;
    if (!cell) {
      this.readout.textContent = "Point at the map to read z, x and y in the base frame.";
      return;
    }
    const [x, y] = this.at_mm, z = this.z_mm[cell[0] * this.cols + cell[1]];
    const place = ` · x ${x.toFixed(1)}, y ${y.toFixed(1)} mm`;
    this.readout.replaceChildren(element("b", { textContent: Number.isNaN(z) ? "not touched" : `z ${z.toFixed(2)} mm` }), place);
  }

  /** z in mm that the canvas shows at a point of the base frame, from its colour; NaN if it shows none. */
  zAt(x_mm, y_mm) {
    const cell = this.about && this.cellOf(x_mm, y_mm);
    if (!cell) return NaN;
    const [red, green, blue, alpha] = this.context.getImageData(cell[1], cell[0], 1, 1).data;
    return alpha === 0 ? NaN : this.low_mm + depthOf(red, green, blue, this.high_mm - this.low_mm);
  }
}
