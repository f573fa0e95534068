// Which map of a hand is to be shown now.

import { zeroMap } from "./geometry.js";

export const CONTACT = 1;
const RELEASE_LOST_MS = 500;

/** The map to draw now, or null when the one that is shown is right. decoded(payload): null where it is damaged. */
export function nextMap(view, geometry, decoded) {
  if (view.height) {
    const map = decoded(view.height);
    view.height = null;
    if (map) return map;
  }
  const free = view.contact?.contact === 0;
  if (!view.map) return free && geometry ? zeroMap(geometry) : null;
  // The one height map of a release can be lost; `contact` goes on to say that nothing touches.
  if (free && view.map.flags & CONTACT && geometry && performance.now() - view.height_ms > RELEASE_LOST_MS) return zeroMap(geometry);
  return geometry !== view.drawnFor ? view.map : null;
}
