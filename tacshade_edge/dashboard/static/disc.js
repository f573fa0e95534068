// The visible disc of a map: the shown part of its cells, and a smooth rim.

const RIM_CELLS = 1.5, DONORS_CELLS = 3;

/**
 * top, left, rows, cols: range of the shown cells. source: for each of them, the index of the map's cell whose value it
 * shows: itself, or just outside the disc the next one inside, so that the rim has a colour up to the clipping circle.
 * clip: that circle as a CSS `clip-path` of the picture; empty without a geometry.
 */
export function fitDisc(map, geometry) {
  const within = (centre, first, count) => {
    if (!geometry) return [0, count];
    const from = Math.max(0, Math.floor((centre - geometry.radius_px - first) / map.step_px));
    const to = Math.min(count, Math.ceil((centre + geometry.radius_px - first) / map.step_px) + 1);
    return to > from ? [from, to - from] : [0, count];
  };
  const [top, rows] = within(geometry?.row_c, map.row0, map.rows), [left, cols] = within(geometry?.col_c, map.col0, map.cols);
  const source = new Int32Array(rows * cols);
  for (let i = top, at = 0; i < top + rows; i++) {
    for (let j = left; j < left + cols; j++, at++) source[at] = geometry ? donorOf(map, geometry, i, j) : i * map.cols + j;
  }
  if (!geometry) return { top, left, rows, cols, source, clip: "" };
  // A cell is centred on its pixel.
  const share = (centre, first, from, count) => (100 * ((centre - first) / map.step_px - from + 0.5)) / count;
  const radius = (count) => (100 * geometry.radius_px) / map.step_px / count;
  const clip = `ellipse(${radius(cols)}% ${radius(rows)}% at ${share(geometry.col_c, map.col0, left, cols)}% ${share(geometry.row_c, map.row0, top, rows)}%)`;
  return { top, left, rows, cols, source, clip };
}

function donorOf(map, { row_c, col_c, radius_px }, i, j) {
  const own = i * map.cols + j, y = (row_c - map.row0) / map.step_px - i, x = (col_c - map.col0) / map.step_px - j, away = Math.hypot(x, y);
  if (!Number.isNaN(map.height_mm[own]) || away > radius_px / map.step_px + RIM_CELLS) return own;
  for (let k = 1; k <= DONORS_CELLS; k++) {
    const r = Math.round(i + (k * y) / away), c = Math.round(j + (k * x) / away);
    if (r >= 0 && c >= 0 && r < map.rows && c < map.cols && !Number.isNaN(map.height_mm[r * map.cols + c])) return r * map.cols + c;
  }
  return own;
}
