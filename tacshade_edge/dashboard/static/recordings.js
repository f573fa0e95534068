// The recordings in a folder on the server's machine: each command opens its own WebSocket to the server.

import { cut } from "./bounds.js";
import { counted, element, number } from "./panels.js";

const FOLD_BYTES = 1 << 24; // the browser can move merged pieces out of the page's memory
const RETRY_MS = 1000, GIVE_UP_MS = 30000; // as long as the server waits for a page that takes nothing
const $ = (id) => document.getElementById(id);

export class Recordings {
  /** listed: the server has a folder of recordings. readOnly: nothing may be played or deleted. played(sensor): called when a recording plays as this sensor. */
  constructor({ listed, readOnly, played }) {
    Object.assign(this, { listed, readOnly, played, playing: null });
    // The browser may keep a page that the user left, with its connections, in case the user comes back.
    addEventListener("pagehide", () => this.playing?.socket.close());
    this.refresh();
  }

  async refresh() {
    if (!this.listed) return;
    try {
      const { recordings } = await command({ action: "list" }).answered;
      this.show(recordings);
    } catch (error) {
      this.say("bad", error.message);
    }
  }

  show(recordings) {
    $("recordings").hidden = recordings.length === 0;
    $("recordings-list").replaceChildren(...recordings.map((recording) => this.row(recording)));
  }

  row({ name, frames, size_bytes, began_ns, is_growing }) {
    const facts = [new Date(began_ns / 1e6).toLocaleString(), frames === null ? "" : counted(frames, "frame"), size_bytes === null ? "" : `${number(size_bytes / 1e6, 1)} MB`, is_growing ? "being written" : frames === null ? "not ended" : ""];
    const button = (words, act, disabled) => element("button", { type: "button", textContent: words, ariaLabel: `${words} ${name}`, disabled, onclick: act });
    const may = !is_growing && !this.readOnly, is_played = this.playing?.name === name;
    const buttons = [
      is_played ? button("End", () => this.playing.socket.close(), false) : button("Play", () => this.play(name), !may || this.playing !== null),
      button("Download", (event) => this.download(name, event.target), is_growing),
      button("Delete", () => this.remove(name), !may || is_played),
    ];
    return element("li", {}, element("b", { textContent: name }), element("small", { textContent: facts.filter(Boolean).join(" · ") }), element("span", {}, ...buttons.flatMap((one) => [one, " "])));
  }

  /** Play a recording for as long as this page keeps the connection open. */
  async play(name) {
    this.say("wait", `starting ${name} …`);
    const { socket, answered, closed } = command({ action: "play", name });
    this.playing = { name, socket };
    try {
      const { sensor } = await answered;
      this.say("good", `playing ${name} as the sensor “${sensor}” while this page is open`);
      this.refresh();
      this.played(sensor);
      const error = await closed;
      this.say(error ? "bad" : "off", error || `${name} no longer plays`);
    } catch (error) {
      this.say("bad", error.message);
    }
    this.playing = null;
    this.refresh();
  }

  async download(name, button) {
    button.disabled = true;
    try {
      const whole = await fetchTar(name, (bytes, of, isLost) => this.say("wait", `${name}: ${number((100 * bytes) / (of || 1))} %${isLost ? "; the connection was lost, trying again …" : ""}`));
      const link = element("a", { href: URL.createObjectURL(whole), download: `${name.replaceAll("/", "-")}.tar` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
      this.say("good", `downloaded ${name}, ${megabytes(whole.size)}`);
    } catch (error) {
      this.say("bad", error.message);
    }
    button.disabled = false;
  }

  async remove(name) {
    if (!confirm(`Delete the recording ${name}? You cannot undo this.`)) return;
    try {
      await command({ action: "delete", name }).answered;
      this.say("good", `deleted ${name}`);
    } catch (error) {
      this.say("bad", error.message);
    }
    this.refresh();
  }

  say(level, words) {
    $("recordings").hidden = false;
    $("recordings-words").dataset.level = level;
    $("recordings-words").textContent = cut(words);
  }
}

const megabytes = (bytes) => `${number(bytes / 1e6, 1)} MB`;

/** Send a command. answered: the first answer; rejects with the error. closed: why the connection ended later; empty without an error. */
function command(asked) {
  const url = new URL("recordings", location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.search = url.hash = "";
  const socket = new WebSocket(url, "tacshade-recordings"), answered = Promise.withResolvers(), closed = Promise.withResolvers();
  let error = "";
  socket.addEventListener("open", () => socket.send(JSON.stringify(asked)));
  socket.addEventListener("message", ({ data }) => {
    const answer = JSON.parse(data);
    if (answer.ok) return answered.resolve(answer);
    error = answer.error;
    answered.reject(new Error(error));
  });
  socket.addEventListener("close", () => {
    answered.reject(new Error("the dashboard’s server does not answer"));
    closed.resolve(error);
  });
  return { socket, answered: answered.promise, closed: closed.promise };
}

/** The tar of a recording; goes on where its connection was lost. progress(bytes, of, isLost): called as bytes come, and when the connection is lost. */
async function fetchTar(name, progress) {
  const url = new URL(`recordings/${name.split("/").map(encodeURIComponent).join("/")}.tar`, location.href);
  let parts = [], fresh = 0, whole = 0, expected = 0, tag = "", came = performance.now();
  const take = (piece) => {
    parts.push(piece);
    whole += piece.length;
    fresh += piece.length;
    came = performance.now();
    if (fresh < FOLD_BYTES) return;
    [parts, fresh] = [[new Blob(parts)], 0];
    progress(whole, expected, false);
  };
  while (!expected || whole < expected) {
    try {
      // Without the cache, which would keep a second copy on the disk.
      const answer = await fetch(url, { cache: "no-store", headers: whole ? { Range: `bytes=${whole}-`, "If-Range": tag } : {} });
      if (!answer.ok) throw new Error((await answer.text()).trim());
      // Of a recording that has changed meanwhile, all of it comes.
      if (answer.status === 200) [parts, fresh, whole, expected, tag] = [[], 0, 0, Number(answer.headers.get("Content-Length")), answer.headers.get("ETag")];
      progress(whole, expected, false);
      for (const reader = answer.body.getReader(); ;) {
        const { done, value } = await reader.read();
        if (done) break;
        take(value);
      }
      if (whole === expected) break;
    } catch (error) {
      if (!(error instanceof TypeError)) throw error; // the others are the connection's
    }
    if (performance.now() - came > GIVE_UP_MS) throw new Error(expected ? `${name}: the connection ended after ${megabytes(whole)} of ${megabytes(expected)}` : "the dashboard’s server does not answer");
    progress(whole, expected, true);
    await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
  }
  return new Blob(parts, { type: "application/x-tar" });
}
