const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

function decode(data) {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const u16 = (at) => view.getUint16(at, true), u32 = (at) => view.getUint32(at, true), f32 = (at) => view.getFloat32(at, true);
  const kind = view.getUint8(5), flags = view.getUint8(7), rows = u16(32), cols = u16(34), n = u32(32), scale = f32(48);
  if (u32(0) !== 0x48534354 || view.getUint8(4) !== 1 || ![1, 2, 3, 4].includes(kind) || view.getUint8(6) !== 0 ||
      data.length !== 96 + u32(84) || u32(84) !== [2 * rows * cols, 14 * n, 4 * rows * cols, 2 * rows * cols][kind - 1]) throw new Error("not a payload of wire version 1");
  let crc = ~0;
  for (let i = 0; i < 88; i++) crc = CRC_TABLE[(crc ^ data[i]) & 255] ^ (crc >>> 8);
  for (let i = 96; i < data.length; i++) crc = CRC_TABLE[(crc ^ data[i]) & 255] ^ (crc >>> 8);
  if (~crc >>> 0 !== u32(88)) throw new Error("damaged");
  const message = { seq: u32(8), t_ns: view.getBigUint64(16, true), wall_ns: view.getBigUint64(24, true), flags,
                    calibration_crc32: u32(12), pose: flags & 16 ? Array.from({ length: 7 }, (_, i) => f32(56 + 4 * i)) : null };
  const values = (Type, length, value) => { const a = new Type(length); for (let i = 0; i < length; i++) a[i] = value(i); return a; };
  if (kind !== 2) {
    const step = (i) => { const v = view.getInt16(96 + 2 * i, true); return v === -32768 ? NaN : v * scale; };
    const map = { ...message, rows, cols, row0: f32(36), col0: f32(40), step_px: f32(44) };
    const name = ["height_mm", , "shear_mm", "sigma_mm"][kind - 1];
    return { ...map, [name]: values(Float32Array, (kind === 3 ? 2 : 1) * rows * cols, step) };
  }
  return { ...message, points_mm: values(Float32Array, 3 * n, (i) => f32(96 + 4 * i)),
           labels: values(Uint16Array, n, (i) => u16(96 + 12 * n + 2 * i)) };
}

// A hand's message, in JSON.
function decodeHand(data) {
  const message = JSON.parse(new TextDecoder().decode(data));
  for (const finger of Object.values(message.fingers)) {
    if (!["contact", "free", "away"].includes(finger.state)) throw new Error("not a finger's state");
    for (const touched of finger.objects) {
      const vectors = ["centroid_mm", "extent_mm", "normal"].map((key) => [touched[key], 3]);
      if (touched.motion)
        vectors.push(...["about_mm", "translation_mm", "rotation_deg"].map((key) => [touched.motion[key], 3]), [touched.motion.covariance, 36]);
      for (const [vector, size] of vectors)
        if (vector.length !== size || !vector.every(Number.isFinite)) throw new Error(`not ${size} numbers: ${vector}`);
    }
  }
  return message;
}

export { decode, decodeHand };
