// Skin points of pixels, from info.geometry (docs/reference/mqtt.md).

/**
 * Write the point where a pixel's ray meets the deformed skin, in mm in the sensor frame, into out[at .. at + 2]:
 * Eq. 2 for an orthographic camera; for a pinhole, the farther intersection with the sphere of radius r - h. A pad's
 * skin is the plane z = -h.
 */
export function skinPoint(geometry, row, col, height_mm, out, at) {
  const rho = geometry.skin_radius_mm - height_mm, d = geometry.camera_distance_mm, isPad = geometry.skin === "pad";
  if (d === null) {
    const x = (col - geometry.col_c) * geometry.mm_per_px, y = (row - geometry.row_c) * geometry.mm_per_px;
    out[at] = x;
    out[at + 1] = y;
    out[at + 2] = isPad ? -height_mm : Math.sqrt(Math.max(rho * rho - x * x - y * y, 0));
    return;
  }
  const u = (col - geometry.col_c) / geometry.f_px, v = (row - geometry.row_c) / geometry.f_px;
  const k = 1 + u * u + v * v;
  const s = isPad ? d - height_mm : (d + Math.sqrt(Math.max(d * d - k * (d * d - rho * rho), 0))) / k;
  out[at] = s * u;
  out[at + 1] = s * v;
  out[at + 2] = s - d;
}

/** Radius in mm and z of the visible circle on the undeformed skin. */
export function rimOf(geometry) {
  if (geometry.skin === "pad") return { rim: geometry.visible_radius_mm, foot: 0 };
  const theta = (geometry.visible_half_angle_deg * Math.PI) / 180, r = geometry.skin_radius_mm;
  return { rim: r * Math.sin(theta), foot: r * Math.cos(theta) };
}

/** A height map without contact, for a sensor that has not been touched since this page opened. */
export function zeroMap(geometry) {
  const step_px = 4, rows = Math.ceil(geometry.image_height_px / step_px), cols = Math.ceil(geometry.image_width_px / step_px);
  const height_mm = new Float32Array(rows * cols);
  for (let i = 0; i < rows; i++) {
    for (let j = 0; j < cols; j++) {
      const away_px = Math.hypot(i * step_px - geometry.row_c, j * step_px - geometry.col_c);
      if (away_px > geometry.radius_px) height_mm[i * cols + j] = NaN;
    }
  }
  return { seq: null, flags: 0, rows, cols, row0: 0, col0: 0, step_px, height_mm, calibration_crc32: geometry.calibration_crc32 };
}

/** Height in mm, interpolated between four cells; a cell outside the disc or the grid counts as 0. */
export function heightAt(map, row, col) {
  const y = (row - map.row0) / map.step_px, x = (col - map.col0) / map.step_px, i = Math.floor(y), j = Math.floor(x);
  const cell = (r, c) => {
    const h = r >= 0 && c >= 0 && r < map.rows && c < map.cols ? map.height_mm[r * map.cols + c] : 0;
    return h !== h ? 0 : h;
  };
  const above = cell(i, j) + (x - j) * (cell(i, j + 1) - cell(i, j)), below = cell(i + 1, j) + (x - j) * (cell(i + 1, j + 1) - cell(i + 1, j));
  return above + (y - i) * (below - above);
}
