// Health of the sensor's daemon and of this page, in readable units. Null and empty values and codes are left out.

import { counted, element, levelOf, number, table } from "./panels.js";
import { lasting } from "./tiles.js";

const FRAMES = {
  published: "with contact, sent", without_contact: "without contact", unasked: "with contact, no subscriber",
  superseded: "replaced by a newer one", invalid: "unusable", failed: "failed or lost", pending: "in progress",
};
const TITLES = { mqtt: "Link to the broker", recorder: "Recorder", reference: "Reference", serial: "Robot", stitching: "Stitching", budget: "Latency budget" };
const WORDS = { uptime: "up", capture: "captured", delivered: "delivered", published: "published", rss: "memory" };
const UNITS = { fps: [1, 1, "frames/s"], ms: [1, 1, "ms"], us: [1e-3, 2, "ms"], ns: [1e-6, 1, "ms"], hz: [1, 1, "Hz"], mm: [1, 2, "mm"], px: [1, 2, "px"], deg: [1, 1, "°"], c: [1, 1, "°C"], bytes: [1e-6, 1, "MB"], percent: [1, 0, "%"] };
const PARTS_OF_ONE = new Set(["light", "contrast", "uneven"]);
const FOR_PROGRAMS = /(_code|^wall_ns|^t_ns|^seq)$/;
const OWN = new Set(["frames", "latency_ms", "stages_ms", "uptime_s", "invalid_reason", "degraded_reason"]);
const $ = (id) => document.getElementById(id);

/** Draw one line while the panel is folded; the rest once it is open. `asked`: as for `showRates`. */
export function showHealth(health, asked, page) {
  const { uptime_s } = health ?? {}, { started, fps, p50 } = lasting(health ?? {}), of = Number.isFinite(asked) ? ` of ${number(asked, asked % 1 ? 1 : 0)}` : "";
  const words = [
    health && !started && "starting", number(fps, 1) && `${number(fps, 1)}${of} frames/s`, number(p50) && `${number(p50)} ms`,
    ...losses(health ?? {}), ...ages(health?.reference?.ageing), Number.isFinite(uptime_s) && `up ${duration(uptime_s)}`,
  ];
  $("health-words").textContent = words.filter(Boolean).join(" · ");
  if ($("health").open) $("tables").replaceChildren(...tables(health ?? {}, page).filter(Boolean));
}

/** In words, how many frames were lost and where; frames that arrived may still miss in a recording. */
function losses({ frames, source_dropped = 0, recorder }) {
  if (!frames) return [];
  const unrecorded = (recorder?.dropped ?? 0) + (recorder?.pre_roll_dropped ?? 0);
  const lost = [[source_dropped, "by the source"], [frames.superseded ?? 0, "replaced by a newer one"], [frames.failed ?? 0, "failed"]].filter(([count]) => count);
  const sum = lost.reduce((total, [count]) => total + count, 0), where = lost.map(([count, words]) => `${count} ${words}`).join(", ");
  return [
    sum ? `${sum} of ${frames.captured + source_dropped} frames lost (${where})` : !unrecorded && "no frame lost",
    unrecorded > 0 && `${counted(unrecorded, "frame")} not recorded`,
  ];
}

/** In words, what ages; nothing while nothing is worth a word. */
const ages = (ageing) => (ageing?.ageing?.length ? [`ageing: ${ageing.ageing.join(", ")}`] : []);

/** Each wear: how far it has come, and until when its limit is expected to hold. */
function wears({ days, reason, wears }) {
  const worn = Object.entries(wears ?? {}).map(([kind, wear]) => {
    const { amount, limit, unit, until } = wear ?? {};
    const [factor, digits, sign] = unit === "mm" ? UNITS.mm : [100, 0, "%"];
    return [kind, `${number(factor * amount, digits)} of ${number(factor * limit, digits)} ${sign}${until ? `, until ${until}` : ""}`];
  });
  return [...worn, ["days seen", short(days)], ["no day is added", short(reason)]];
}

/** Draw one line per `status/<part>`: its state, its reason, then its details. */
export function showParts(parts) {
  $("parts").replaceChildren(...[...parts].sort().map(([name, { state, reason, ...details }]) => {
    const badge = element("span", { className: "badge", textContent: state }), rest = facts(details).map(([key, value]) => `${key} ${value}`).join(", ");
    badge.dataset.level = levelOf(state);
    return element("p", {}, element("b", { textContent: `${name} ` }), badge, reason ? ` ${reason}` : "", rest ? element("small", { textContent: ` ${rest}` }) : "");
  }));
}

function tables(health, page) {
  const { frames, latency_ms, stages_ms, uptime_s } = health, { started, settled } = lasting(health);
  const { ageing, ...reference } = health.reference ?? {};
  const others = Object.entries({ ...health, ...(health.reference ? { reference } : {}) }).filter(([key]) => !OWN.has(key) && (started || !key.endsWith("_fps")));
  const share = (count) => (frames.captured ? `${count} (${number((100 * count) / frames.captured)} %)` : String(count));
  const counted = frames ? Object.entries(FRAMES).filter(([key]) => frames[key]).map(([key, words]) => [words, share(frames[key])]) : [];
  const stages = Object.entries({ ...stages_ms, "total, until sent": latency_ms }).filter(([, stage]) => stage && started);
  const flat = Object.fromEntries(others.filter(([, value]) => typeof value !== "object"));
  return [
    frames && table("Frames", [["captured", frames.captured ?? ""], ...counted]),
    table("Sensor", [["up", Number.isFinite(uptime_s) ? duration(uptime_s) : ""], ...facts(flat)]),
    table("Time per stage", stages.map(([key, { p50, p99 }]) => [key, ms(p50), settled ? ms(p99) : ""]), ["", "half within", "99 % within"]),
    ...others.filter(([, value]) => value && typeof value === "object").map(([key, value]) => table(TITLES[key] ?? key.replaceAll("_", " "), facts(value))),
    ageing && table("Ageing", wears(ageing)),
    table("This page", page),
  ];
}

const ms = (value) => (Number.isFinite(value) ? `${number(value, 1)} ms` : "");

/** The readable entries of an object: [words, value with its unit] for each that has a value. */
function facts(object) {
  return Object.entries(object).filter(([key]) => !FOR_PROGRAMS.test(key)).flatMap(([key, value]) => {
    const [, stem, suffix] = /^(.*?)_?([^_]*)$/.exec(key), unit = typeof value === "number" && stem ? suffix : "";
    const [shown, words] = unit === "s" ? [duration(value), stem] : Object.hasOwn(UNITS, unit) ? [inUnit(value, UNITS[unit]), stem]
      : key === "bytes" ? [inUnit(value, UNITS.bytes), "size"] : PARTS_OF_ONE.has(key) && typeof value === "number" ? [`${number(100 * value)} %`, key] : [short(value), key];
    return shown === "" ? [] : [[Object.hasOwn(WORDS, words) ? WORDS[words] : words.replaceAll("_", " "), shown]];
  });
}

const inUnit = (value, [factor, digits, unit]) => `${number(value * factor, Number.isInteger(value * factor) ? 0 : digits)} ${unit}`;

function short(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") return number(value, Number.isInteger(value) ? 0 : 2);
  if (typeof value !== "object") return String(value);
  return (Array.isArray(value) ? value.map(short) : facts(value).map(([key, shown]) => `${key} ${shown}`)).filter((part) => part !== "").join(", ");
}

/** 12 s, 4 min 5 s, 2 h 10 min, 3 days 4 h. */
function duration(seconds) {
  const s = Math.round(seconds);
  const [[one, unit], [less, lesser]] = s < 60 ? [[1, "s"], [1, ""]] : s < 3600 ? [[60, "min"], [1, "s"]] : s < 86400 ? [[3600, "h"], [60, "min"]] : [[86400, "days"], [3600, "h"]];
  if (s < 60) return `${number(seconds, Number.isInteger(seconds) || s > 9 ? 0 : 1)} s`;
  const rest = Math.floor((s % one) / less);
  return `${Math.floor(s / one)} ${unit}${rest ? ` ${rest} ${lesser}` : ""}`;
}
