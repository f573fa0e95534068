// Where a pixel's skin point is, from info.geometry (docs/mqtt.md).

/**
 * Point of the deformed skin that a pixel's ray meets, in mm in the sensor frame, into out[at .. at + 2].
 * Eq. 2 for an orthographic camera; for a pinhole the farther point where the ray meets the sphere of radius r - h.
 */
export function skinPoint(geometry, row, col, height_mm, out, at) {
  const rho = geometry.skin_radius_mm - height_mm, d = geometry.camera_distance_mm;
  if (d === null) {
    const x = (col - geometry.col_c) * geometry.mm_per_px, y = (row - geometry.row_c) * geometry.mm_per_px;
    out[at] = x;
    out[at + 1] = y;
    out[at + 2] = Math.sqrt(Math.max(rho * rho - x * x - y * y, 0));
    return;
  }
  const u = (col - geometry.col_c) / geometry.f_px, v = (row - geometry.row_c) / geometry.f_px;
  const k = 1 + u * u + v * v;
  const s = (d + Math.sqrt(Math.max(d * d - k * (d * d - rho * rho), 0))) / k;
  out[at] = s * u;
  out[at + 1] = s * v;
  out[at + 2] = s - d;
}

/** A height map without contact, for a hand that has not been touched since this page looks. */
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
