// Playback of a recording: the buttons for `req/replay`, for a sensor that publishes `status/replay`.

import { number } from "./panels.js";

const form = document.getElementById("playback");
const SPEEDS_MAX = 20;
let winding = false; // the user is moving the slider

/** Whether the sensor is a recording that a page can control. */
export const isPlayed = (parts) => ["playing", "paused"].includes(parts.get("replay")?.state);
export const isPaused = (parts) => parts.get("replay")?.state === "paused";

/** A paused recording publishes nothing: make it publish its frame again if this page has no picture yet. Rejects as `request` does. */
export async function showAgain(link, sensor, view) {
  if (view.asked || view.map || view.height || !isPaused(view.parts)) return;
  view.asked = true;
  await link.request(sensor, "replay", { seek_s: justBefore(view.parts.get("replay").position_s) });
}

/** The position to seek in order to reach the frame at this one: positions are rounded to milliseconds. */
export const justBefore = (position_s) => Math.max(position_s - 0.001, 0);

/** Connect the buttons. ask(body): sends a request to the replay; resolves once it has answered. */
export function commandPlayback(ask) {
  const { step, back, position, speed } = form.elements;
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    ask({ paused: form.dataset.state === "playing" });
  });
  step.addEventListener("click", () => ask({ step: true }));
  back.addEventListener("click", () => ask({ back: true }));
  speed.addEventListener("change", () => ask({ speed: Number(speed.value) }));
  position.addEventListener("input", () => { winding = true; });
  position.addEventListener("change", async () => {
    await ask({ seek_s: Number(position.value) });
    winding = false;
  });
}

/** `runs`: a replay that was killed has left the status of its last moment. */
export function updatePlayback(parts, runs, able) {
  form.hidden = !runs || !isPlayed(parts);
  if (form.hidden) return;
  const status = parts.get("replay"), { play, step, back, position, speed } = form.elements;
  form.dataset.state = status.state;
  play.textContent = status.state === "playing" ? "Pause" : "Play";
  for (const control of [play, step, back, position, speed]) control.disabled = !able;
  position.hidden = !(status.length_s > 0);
  position.max = status.length_s;
  if (!winding) position.value = status.position_s;
  if (speed.options.length < SPEEDS_MAX && ![...speed.options].some((option) => Number(option.value) === status.speed)) speed.add(new Option(`${status.speed} ×`, status.speed));
  speed.value = status.speed;
  form.querySelector("output").textContent = `${number(status.position_s, 2)} s${status.length_s > 0 ? ` of ${number(status.length_s, 2)} s` : ""}, frame ${status.frame}`;
}
