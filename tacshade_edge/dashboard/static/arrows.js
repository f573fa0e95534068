// How the skin moved, as arrows over the height map: from where it was to where it is.

const LEAST_MM = 0.1, ACROSS = 15, HEAD = 0.35;

/** Draw a decoded `shear` into an SVG path, in image pixels; nothing where nothing moved, or without both. */
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
