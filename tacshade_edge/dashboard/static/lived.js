// The list of contacts with their begin and end, newest first.

import { number, table } from "./panels.js";

const MOST = 10, SLIPS = ["sticks", "slips partly", "slips"];
const HEAD = ["began", "s", "deepest, mm", "volume, mm³", "shear, mm", "objects", "slip"];
const $ = (id) => document.getElementById(id);

/** Add an `event/contact` to the list, in place of an earlier one of the same contact. */
export function withEvent(list, event) {
  return [event, ...list.filter(({ id, start_ns }) => id !== event.id || start_ns !== event.start_ns)].slice(0, MOST);
}

export function showContacts(list) {
  $("lived").hidden = list.length === 0;
  const { type, id } = list[0] ?? {};
  $("lived-words").textContent = type === "end" || !id ? "" : "one goes on";
  $("lived-list").replaceChildren(table("", list.map(row), ["", ...HEAD]) ?? "");
}

function row({ id, type, start_ns, end_ns, t_ns, wall_ns, depth_max_mm, volume_mm3, shear_mm, objects, slip }) {
  const began = new Date((wall_ns - (t_ns - start_ns)) / 1e6).toLocaleTimeString();
  const lasted = number(((type === "end" ? end_ns : t_ns) - start_ns) / 1e9, 1);
  return [id, began, lasted, number(depth_max_mm, 2), number(volume_mm3, 1), number(shear_mm, 2), number(objects), SLIPS[slip] ?? ""];
}
