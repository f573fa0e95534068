// Words and numbers. Text from the broker enters the page as text, never as HTML.

import { objectColour } from "./colours.js";

const LEVELS = { online: "good", streaming: "good", playing: "good", paused: "warn", open: "good", degraded: "warn", away: "warn", unusable: "warn", stopped: "off", ended: "off", idle: "off", offline: "bad" };

export const levelOf = (state) => LEVELS[state] ?? "warn";

export function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** A dot in the colour of an object's points. */
export function dotOf(label) {
  const dot = element("i", { className: "dot" });
  dot.style.background = objectColour(label);
  return dot;
}

/** `1 frame`, `2 frames`, `2 presses`. */
export const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : noun.endsWith("s") ? "es" : "s"}`;

/** A number with `digits` digits; empty if it is no number. */
export function number(value, digits = 0) {
  return Number.isFinite(value) ? value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1") : "";
}

/** The state of the sensor with every known reason for it. */
export function showState(state, parts, health, connected, gone) {
  const reasons = [...parts].filter(([, part]) => part.reason).map(([name, part]) => `${name}: ${part.reason}`);
  const shown = [...parts.values()].some((part) => part.reason === health?.invalid_reason);
  if (health?.invalid_reason && !shown) reasons.push(`latest frame unusable: ${health.invalid_reason}`);
  if (health?.degraded_reason) reasons.push(`less certain: ${health.degraded_reason}`);
  const line = document.getElementById("state");
  if (!connected) {
    line.dataset.level = "off";
    line.textContent = `last heard: ${state ?? "nothing"}`;
    return;
  }
  line.dataset.level = reasons.length && state === "online" ? "warn" : levelOf(state);
  line.replaceChildren(element("b", { textContent: state ?? "unknown" }), reasons.length ? `${gone ? " last reported:" : ""} ${reasons.join("; ")}` : "");
}

/** A table without the rows that have no value; null if none is left. */
export function table(title, rows, head) {
  const kept = rows.filter(([, ...values]) => values.some((value) => value !== ""));
  if (kept.length === 0) return null;
  const body = kept.map(([name, ...values]) => element("tr", {}, element("th", { textContent: name, scope: "row" }), ...values.map((value) => element("td", { textContent: value }))));
  if (head) body.unshift(element("tr", {}, ...head.map((text) => element("th", { textContent: text, scope: "col" }))));
  return element("table", {}, ...(title ? [element("caption", { textContent: title })] : []), element("tbody", {}, ...body));
}
