// Marks over the height map: arrows for the motion of the skin, from old to new place, and strokes over uncertain cells.

const LEAST_MM = 0.1, ACROSS = 15, HEAD = 0.35;
const STROKES_ACROSS = 56, NINETY_PERCENT = 1.645; // standard deviations

/** Draw a decoded `shear` into an SVG path, in image pixels; nothing if nothing moved, or without shear or geometry. */
export function drawArrows(path, shear, geometry) {
  const parts = [];
  if (shear && geometry) {
    const every = Math.max(1, Math.round((2 * geometry.radius_px) / shear.step_px / ACROSS)), first = Math.floor(every / 2);
    for (let i = first; i < shear.rows; i += every) {
      for (let j = first; j < shear.cols; j += every) {
        const at = 2 * (i * shear.cols + j), x_mm = shear.shear_mm[at], y_mm = shear.shear_mm[at + 1];
        if (!(Math.hypot(x_mm, y_mm) >= LEAST_MM)) continue;
        const x = shear.col0 + j * shear.step_px, y = shear.row0 + i * shear.step_px;
        const dx = x_mm / geometry.mm_per_px, dy = y_mm / geometry.mm_per_px, hx = HEAD * dx, hy = HEAD * dy;
        const point = (px, py) => `${px.toFixed(1)} ${py.toFixed(1)}`;
        parts.push(`M${point(x - dx, y - dy)}L${point(x, y)}M${point(x - hx - hy / 2, y - hy + hx / 2)}L${point(x, y)}L${point(x - hx + hy / 2, y - hy - hx / 2)}`);
      }
    }
  }
  path.setAttribute("d", parts.join(""));
  return parts.length;
}

/** Draw strokes over the touched cells whose 90 % interval includes zero depth; nothing without both maps on one grid. */
export function drawDoubts(path, map, sigma, geometry) {
  const parts = [];
  if (map && geometry && sigma?.rows === map.rows && sigma.cols === map.cols) {
    const every = Math.max(1, Math.round((2 * geometry.radius_px) / map.step_px / STROKES_ACROSS)), half = (every * map.step_px) / 3;
    for (let i = 0; i < map.rows; i += every) {
      for (let j = 0; j < map.cols; j += every) {
        const at = i * map.cols + j;
        if (!(NINETY_PERCENT * sigma.sigma_mm[at] >= map.height_mm[at])) continue;
        const x = map.col0 + j * map.step_px, y = map.row0 + i * map.step_px;
        parts.push(`M${(x - half).toFixed(1)} ${(y + half).toFixed(1)}l${(2 * half).toFixed(1)} ${(-2 * half).toFixed(1)}`);
      }
    }
  }
  path.setAttribute("d", parts.join(""));
  return parts.length;
}
