// The buttons of the recorder, for a sensor that publishes `status/recorder`.

import { counted, number } from "./panels.js";

const form = document.getElementById("recording");

/** Connect the buttons. ask(body, doing, done): sends a request to the sensor. */
export function commandRecordings(ask) {
  const { seconds, record, mark, words, stop } = form.elements;
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (record.parentElement.hidden) mark.click(); // Enter in the text of the mark
    else ask({ action: "start", seconds: Number(seconds.value) }, "Beginning …", (result) => `Recording to ${result.folder}.`);
  });
  mark.addEventListener("click", () => {
    const text = words.value.trim();
    ask({ action: "mark", text }, "Marking …", (result) => `Marked ${text ? `“${text}” ` : ""}after frame ${result.frames}.`);
    words.value = "";
  });
  stop.addEventListener("click", () => ask({ action: "stop" }, "Writing …", (result) => `Recorded ${counted(result.frames, "frame")} in ${result.folder}.`));
}

export function updateRecording(status, able) {
  form.hidden = !status;
  if (!status) return;
  const going = status.state === "recording", { seconds, record, mark, words, stop } = form.elements;
  record.parentElement.hidden = going;
  stop.parentElement.hidden = !going;
  for (const control of [seconds, record, mark, words, stop]) control.disabled = !able;
  form.dataset.going = going;
  form.querySelector("output").textContent = going
    ? `Recording ${minutes(status.seconds)} of ${minutes(status.of_seconds)}: ${counted(status.frames, "frame")}, ${number(status.bytes / 1e6, 1)} MB${status.dropped ? `, ${status.dropped} dropped` : ""}` : "";
}

function minutes(seconds) {
  const s = Math.floor(seconds ?? 0);
  return `${Math.floor(s / 60)}:${String(s % 60).padStart(2, "0")}`;
}
