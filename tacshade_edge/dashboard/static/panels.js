// What is shown in words and numbers. Text from the broker goes into the page as text, never as HTML.

const LEVELS = { online: "good", streaming: "good", playing: "good", paused: "warn", open: "good", degraded: "warn", away: "warn", unusable: "warn", stopped: "off", ended: "off", idle: "off", offline: "bad" };
const FRAMES = {
  published: "with contact, sent", without_contact: "without contact", unasked: "with contact, nobody listened",
  superseded: "replaced by a newer one",  invalid: "not usable", failed: "failed or lost", pending: "on their way",
};

export const levelOf = (state) => LEVELS[state] ?? "warn";

export function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

export function number(value, digits = 0) {
  return typeof value === "number" && Number.isFinite(value) ? value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1") : "–";
}

function put(id, text) {
  document.getElementById(id).textContent = text;
}

export function showContact(contact) {
  put("n-depth", number(contact?.depth_max_mm, 2));
  put("n-objects", number(contact?.objects));
  put("n-area", number(contact?.area_mm2, 1));
  put("n-volume", number(contact?.volume_mm3, 1));
  put("n-place", !contact ? "–" : contact.x_mm === null ? "none" : `${number(contact.x_mm, 1)}, ${number(contact.y_mm, 1)} mm`);
}

export function showRates(health) {
  put("n-fps", number(health?.delivered_fps, 1));
  put("n-latency", health?.latency_ms ? `${number(health.latency_ms.p50, 0)}, ${number(health.latency_ms.p99, 0)}` : "–");
}

/** The state of the sensor with every reason that is known for it. */
export function showState(state, parts, health, connected, gone) {
  const reasons = [...parts].filter(([, part]) => part.reason).map(([name, part]) => `${name}: ${part.reason}`);
  const shown = [...parts.values()].some((part) => part.reason === health?.invalid_reason);
  if (health?.invalid_reason && !shown) reasons.push(`latest frame not usable: ${health.invalid_reason}`);
  if (health?.degraded_reason) reasons.push(`less trust: ${health.degraded_reason}`);
  const line = document.getElementById("state");
  if (!connected) {
    line.dataset.level = "off";
    line.textContent = `last heard: ${state ?? "nothing"}`;
    return;
  }
  line.dataset.level = reasons.length && state === "online" ? "warn" : levelOf(state);
  line.replaceChildren(element("b", { textContent: state ?? "unknown" }), reasons.length ? `${gone ? " last reported:" : ""} ${reasons.join("; ")}` : "");
}

/** One line per `status/<part>`: its state, its reason, then its own details; codes are for programs. */
export function showParts(parts) {
  const lines = [...parts].sort().map(([name, { state, reason, ...details }]) => {
    const badge = element("span", { className: "badge", textContent: state });
    badge.dataset.level = levelOf(state);
    const rest = Object.entries(details).filter(([key]) => !key.endsWith("_code")).map(([key, value]) => `${key} ${short(value)}`).join(", ");
    return element("p", {}, element("b", { textContent: `${name} ` }), badge, reason ? ` ${reason}` : "", rest ? element("small", { textContent: ` ${rest}` }) : "");
  });
  document.getElementById("parts").replaceChildren(...lines);
}

/** Everything that `health` has, also what a newer daemon adds to it. */
export function showHealth(health, page) {
  const { frames, latency_ms, stages_ms, mqtt, uptime_s, invalid_reason, degraded_reason, ...others } = health ?? {};
  const tables = [];
  if (frames) {
    const rows = Object.entries(FRAMES).filter(([key]) => key in frames).map(([key, text]) => [text, frames[key]]);
    tables.push(table("Frames", [["captured", frames.captured], ...rows]));
  }
  const rates = Object.entries(others).filter(([, value]) => typeof value !== "object");
  if (health) tables.push(table("Sensor", [["up", duration(uptime_s)], ...rates.map(([key, value]) => [key.replaceAll("_", " "), short(value)])]));
  if (latency_ms || stages_ms) {
    const stages = Object.entries({ ...stages_ms, "all, until sent": latency_ms }).filter(([, stage]) => stage);
    tables.push(table("Milliseconds", stages.map(([key, stage]) => [key.replaceAll("_", " "), number(stage.p50, 1), number(stage.p99, 1)]), ["", "p50", "p99"]));
  }
  if (mqtt) tables.push(table("Broker link of the sensor", Object.entries(mqtt).map(([key, value]) => [key.replaceAll("_", " "), short(value)])));
  for (const [key, value] of Object.entries(others)) {
    if (value && typeof value === "object") tables.push(table(key.replaceAll("_", " "), Object.entries(value).map(([k, v]) => [k.replaceAll("_", " "), short(v)])));
  }
  tables.push(table("This page", page));
  document.getElementById("tables").replaceChildren(...tables);
}

export function table(title, rows, head) {
  const body = rows.map(([name, ...values]) => element("tr", {}, element("th", { textContent: name, scope: "row" }), ...values.map((value) => element("td", { textContent: value }))));
  if (head) body.unshift(element("tr", {}, ...head.map((text) => element("th", { textContent: text, scope: "col" }))));
  return element("table", {}, element("caption", { textContent: title }), element("tbody", {}, ...body));
}

function short(value) {
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(+value.toFixed(2));
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

function duration(seconds) {
  if (typeof seconds !== "number") return "–";
  const s = Math.floor(seconds), two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
}
