// The page: the sensors, the data of the chosen one, and when to draw it.

import { PARTS_MAX, SENSORS_MAX, checkContact, checkDecoded, checkEvent, checkInfo, checkObject, checkPart, checkTouch, cut, objectsIn, read } from "./bounds.js";
import { DepthChart } from "./chart.js";
import { Compare } from "./compare.js";
import { freshness } from "./freshness.js";
import { HeightView } from "./heightmap.js";
import { showHealth, showParts } from "./health.js";
import { Link } from "./link.js";
import { showContacts, withEvent } from "./lived.js";
import { MapView } from "./mapview.js";
import { drawArrows } from "./marks.js";
import { CONTACT, INVALID, TOUCHED, contactOfMap, keep, keepContact, nextMap, partOfMap, touchOfMap } from "./newest.js";
import { counted, dotOf, element, levelOf, number, showState } from "./panels.js";
import { SkinView } from "./skin3d.js";
import { commandPlayback, isPaused, isPlayed, showAgain, updatePlayback } from "./playback.js";
import { commandRecordings, updateRecording } from "./record.js";
import { Recordings } from "./recordings.js";
import { isRemoved, remove, restore } from "./retired.js";
import { Rezero } from "./rezero.js";
import { UNMEASURED, showContact, showNames, showRates, withName } from "./tiles.js";
import { decodedPart, store, stored } from "./stored.js";
import { TouchPanel } from "./touch.js";
import { Whole } from "./hand_view.js";
import { decode } from "./wire.js";

const SATURATED = 4, DEGRADED = 8;
const FULL_SLIP = 2;
const UNLISTED = "paper"; // far slower and less exact: a study's baseline, still chosen by request
const WHOLE = "#hand/"; // in an address, before the hand's id
const MAP_MS = 60000; // a board takes seconds for the final map of a thousand presses
const STREAMS = ["height", "cloud", "shear", "sigma", "contact", "event/contact", "event/object", "health", "preview", "status/+", "res/+", "map/+"];
const READ_ONLY = "readOnly" in document.documentElement.dataset; // the server forwards no requests
const $ = (id) => document.getElementById(id);
const text = new TextDecoder();

const sensors = new Map(); // sensor id -> { state, info }
let chosen = null, view = emptyView(), undecodable = 0, heard = 0, superseded = 0, drawn = 0, arrows = 0, drawTimes = [], scheduled = false, picture = "";
let link = null, asking = false;

const heights = new HeightView(), stitched = new MapView(), skin = new SkinView(schedule), chart = new DepthChart(), touch = new TouchPanel({ link: () => link });
const compare = new Compare({ link: () => link, decoded, changed: schedule, readOnly: READ_ONLY });
const whole = new Whole({ link: () => link, infos: (sensor) => sensors.get(sensor)?.info, decoded, changed: schedule, damaged: () => { undecodable++; } });
const rezero = new Rezero({
  ask: () => ask("reference", {}, "Taking a new reference; do not touch the skin …", (result) => `Took a new zero from ${counted(result.frames, "frame")}.`),
  changed: (words) => {
    $("rezero").textContent = rezero.waiting && !rezero.taking ? "Cancel re-zero" : "Re-zero";
    if (rezero.waiting && !rezero.taking) updateAnswer("wait", "Re-zero waits until nothing touches the skin …");
    if (words) updateAnswer("off", words);
    updateControls();
  },
});
const recordings = new Recordings({
  listed: "recordings" in document.documentElement.dataset, readOnly: READ_ONLY,
  played: (sensor) => {
    if (location.hash !== `#${sensor}`) location.hash = sensor;
    else follow();
  },
});
link = new Link({ reported: updateLink, refused: askLogin, message: take });
link.subscribe("tacshade/+/state", "tacshade/+/info", "tacshade/hand/+/state");

/** All data of the chosen sensor. */
function emptyView() {
  return {
    height: null, cloud: null, shear: null, sigma: null, map: null, mapPayload: null, mapCloud: null, about: {}, contact: null, contacts: new Map(), lived: [], named: [], numbers: null, touches: new Map(), touch: null, touch_ms: 0, with_map: {}, shown_ms: 0, health: null, parts: new Map(), heard_ms: null, health_ms: null, chosen_ms: performance.now(), height_ms: 0, age_ms: null,
  };
}

// Messages. The page keeps only the newest binary payloads, and decodes them when it draws them.

function take(topic, payload, retained) {
  if (whole.take(topic, payload)) return topic.endsWith("/state") ? showTabs() : undefined;
  const [, sensor, ...rest] = topic.split("/"), what = rest.join("/");
  if (what === "state" || what === "info") {
    if (!sensors.has(sensor) && sensors.size >= SENSORS_MAX && sensor !== decodedPart(location.hash.slice(1))) undecodable++;
    else if (what === "state") takeNews(sensor, { state: cut(text.decode(payload), 40) || undefined });
    else json(payload, (info) => takeNews(sensor, { info }), checkInfo);
  }
  else if (sensor === chosen) takeChosen(what, payload, retained);
  else if (sensor === compare.sensor) compare.take(what, payload, json);
  else if (what === "height") whole.takeHeight(sensor, payload);
}

function takeChosen(what, payload, retained) {
  if (what === "height" || what === "cloud" || what === "shear" || what === "sigma") {
    if (what === "height") {
      heard++;
      if (view.height) superseded++;
      view.heard_ms = view.height_ms = performance.now();
    }
    view[what] = payload;
    schedule();
  } else if (what === "contact") {
    json(payload, (contact) => {
      keepContact(view, contact);
      if (contact.contact === 0 && !contact.touched && view.named.length) showNames(view.named = []);
      view.heard_ms = performance.now();
      chart.add(contact.depth_max_mm ?? null, contact.slip === FULL_SLIP);
      rezero.heard(contact);
      schedule();
    }, checkContact);
  } else if (what === "event/contact") {
    json(payload, (event) => showContacts(view.lived = withEvent(view.lived, event)), checkEvent);
  } else if (what === "event/object") {
    json(payload, (event) => {
      view.named = withName(view.named, event);
      showNames(view.named);
    }, checkObject);
  } else if (what === "touch") {
    json(payload, (numbers) => {
      keep(view.touches, numbers);
      schedule();
    }, checkTouch);
  } else if (what === "health") {
    json(payload, (health) => {
      view.health = health;
      if (!retained) view.health_ms = performance.now();
      updateHealth();
    });
  } else if (what.startsWith("status/") && payload.length === 0) { // the part no longer exists: a rival
    view.parts.delete(what.slice(7));
    showParts(view.parts);
  } else if (what.startsWith("status/")) {
    json(payload, (part) => {
      if (!view.parts.has(what.slice(7)) && view.parts.size >= PARTS_MAX) return void undecodable++;
      if (what === "status/recorder" && view.parts.get("recorder")?.state !== part.state) recordings.refresh();
      view.parts.set(cut(what.slice(7), 64), part);
      if (!READ_ONLY) showAgain(link, chosen, view).catch((error) => updateAnswer("bad", error.message));
      showParts(view.parts);
      updateHealth();
    }, checkPart);
  } else if (what === "map/cloud") {
    view.mapPayload = payload;
    schedule();
  } else if (what === "map/revision" || what === "map/final") {
    json(payload, (about) => {
      view.about[what] = about;
      schedule();
    });
  } else if (what === "preview") {
    URL.revokeObjectURL(picture);
    picture = URL.createObjectURL(new Blob([payload], { type: "image/jpeg" }));
    $("picture").src = picture;
    $("preview").hidden = false;
  }
}

function json(payload, use, check = (value) => value) {
  let value;
  try {
    value = check(read(payload));
  } catch {
    undecodable++;
    return;
  }
  use(value);
}

function decoded(payload, name) {
  try {
    return checkDecoded(decode(payload), name);
  } catch {
    undecodable++;
    return null;
  }
}

// Sensors.

function takeNews(sensor, news) {
  const known = sensors.has(sensor);
  if ("state" in news && news.state === undefined) sensors.delete(sensor); // the retained state was cleared
  else sensors.set(sensor, { ...sensors.get(sensor), ...news });
  if (works(sensor)) restore(sensor);
  if (isRemoved(sensor)) return showTabs();
  // The sensor in the address; without one, the first that works, rather than one that is long gone.
  const wanted = decodedPart(location.hash.slice(1));
  if (wanted ? !known && sensor === wanted : works(sensor) && !works(chosen) && view.heard_ms === null) choose(sensor);
  if (chosen === null && whole.shown === null) choose(sensor);
  showTabs();
  if (sensor === chosen) {
    updateProfiles();
    updateState();
    schedule();
  }
}

/** Remove a sensor from this page, and show another one, or none. */
function retire(sensor) {
  remove(sensor);
  const other = [...sensors.keys()].sort().find((name) => !isRemoved(name));
  if (other !== undefined) {
    location.hash = encodeURIComponent(other);
    choose(other);
  } else leave();
}

/** Show no sensor. */
function leave() {
  if (chosen === null) return;
  link.unsubscribe(...STREAMS.map((stream) => `tacshade/${chosen}/${stream}`));
  rezero.cancel();
  compare.choose(null);
  chosen = null;
  touch.choose(null);
  $("sensor").hidden = true;
  showTabs();
}

/** Show all fingers of a hand of several sensors. */
function chooseWhole(id) {
  leave();
  whole.show(id);
  $("waiting").hidden = true;
  document.title = `${id} – TacShade`;
  showTabs();
}

const works = (sensor) => ["online", "degraded"].includes(sensors.get(sensor)?.state);

function choose(sensor) {
  if (sensor === chosen) return;
  whole.hide();
  if (chosen !== null) link.unsubscribe(...STREAMS.map((stream) => `tacshade/${chosen}/${stream}`));
  rezero.cancel();
  chosen = sensor;
  view = emptyView();
  drawTimes = [];
  heights.clear();
  stitched.clear();
  skin.clear();
  chart.clear();
  arrows = drawArrows($("arrows"), null, null);
  $("preview").hidden = $("free").hidden = true;
  $("answer").textContent = "";
  $("waiting").hidden = true;
  $("sensor").hidden = false;
  document.title = `${sensor} – TacShade`;
  link.subscribe(...STREAMS.map((stream) => `tacshade/${sensor}/${stream}`));
  touch.choose(sensor);
  showContact(null);
  showContacts(view.lived);
  showNames(view.named);
  showParts(view.parts);
  showTabs();
  updateState();
  updateProfiles();
  updateHealth();
  schedule();
}

function showTabs() {
  const tabs = [...sensors].filter(([sensor]) => !isRemoved(sensor)).sort(([a], [b]) => a.localeCompare(b)).map(([sensor, known]) => {
    const tab = element("button", { type: "button", title: link?.connected ? known.state ?? "unknown" : "not connected", onclick: () => { location.hash = encodeURIComponent(sensor); choose(sensor); } }, sensor);
    tab.dataset.level = link?.connected ? levelOf(known.state) : "off";
    if (sensor === chosen) tab.ariaCurrent = "page";
    return tab;
  });
  const whole_tabs = [...whole.states].sort().map(([id, state]) => {
    const tab = element("button", { type: "button", title: "all fingers of this hand", onclick: () => { location.hash = `${WHOLE}${encodeURIComponent(id)}`; } }, `hand ${id}`);
    tab.dataset.level = link?.connected ? levelOf(state) : "off";
    if (id === whole.shown) tab.ariaCurrent = "page";
    return tab;
  });
  $("sensors").replaceChildren(...whole_tabs, ...tabs);
  compare.offer([...sensors].filter(([sensor, { info }]) => sensor !== chosen && info?.geometry && !isRemoved(sensor)).map(([sensor]) => sensor).sort());
  const removed = [...sensors.keys()].filter(isRemoved).length;
  $("restore").hidden = removed === 0;
  $("restore").textContent = `Show ${removed} removed`;
}

function follow() {
  const wanted = decodedPart(location.hash.slice(1));
  if (sensors.has(wanted)) choose(wanted);
  else if (location.hash.startsWith(WHOLE)) chooseWhole(decodedPart(location.hash.slice(WHOLE.length)));
}
window.addEventListener("hashchange", follow);
follow();

// Drawing: at most once per animation frame, always the newest.

function schedule() {
  if (scheduled || skin.busy) return; // the 3D skin reports when it is done: then both views draw the newest
  scheduled = true;
  requestAnimationFrame(draw);
}

function draw() {
  scheduled = false;
  whole.draw();
  if (skin.busy || chosen === null) return;
  const geometry = sensors.get(chosen)?.info?.geometry ?? null;
  const map = nextMap(view, geometry, decoded);
  let redraw = map !== null;
  if (map) {
    if (map.seq !== null) {
      drawn++;
      drawTimes.push(performance.now());
      if (drawTimes.length > 120) drawTimes.shift();
      view.age_ms = Date.now() - Number(map.wall_ns / 1000000n);
    }
    view.map = map;
    view.shown_ms = performance.now();
    view.drawnFor = geometry;
    heights.draw(map, geometry);
    skin.setSkin(map, geometry, heights.scale_mm);
    updateFlags(map.flags);
    if (!(map.flags & CONTACT)) {
      updateObjects(null);
      heights.setSigma(null);
      arrows = drawArrows($("arrows"), null, null);
    }
  }
  const [sigma, cloud, shear] = ["sigma", "cloud", "shear"].map((what) => partOfMap(view, what, decoded));
  const touched = view.map && view.map.flags & CONTACT;
  if (sigma !== undefined) heights.setSigma(sigma);
  if (cloud !== undefined && touched) {
    updateObjects(cloud);
    redraw = true;
  }
  if (shear !== undefined && touched) arrows = drawArrows($("arrows"), shear, geometry);
  drawStitched();
  compare.draw({ name: chosen, view, info: sensors.get(chosen)?.info }, sensors.get(compare.sensor) ?? {}, heights);
  if (redraw) skin.render();
  const numbers = contactOfMap(view);
  showContact(numbers);
  if (view.map) showFree(view.map.flags, numbers);
  $("arrows").classList.toggle("slides", numbers?.slip === FULL_SLIP);
  if (view.map) touch.draw(touchOfMap(view));
  updateStale();
}

/** What the map says while it shows no contact. The numbers continue after the last map, so they come first. */
function showFree(flags, numbers) {
  const free = (flags & (CONTACT | INVALID)) === 0 && numbers?.contact !== null, touched = free && (numbers ? numbers.touched === 1 : (flags & TOUCHED) !== 0);
  $("free").hidden = !free;
  $("free").textContent = touched ? UNMEASURED : "nothing touches";
  $("map").classList.toggle("is-touched", touched);
}

/** Points and their description come as two messages, and the `final` of an earlier session remains during a new one. */
function drawStitched() {
  if (view.mapPayload) {
    view.mapCloud = decoded(view.mapPayload, "points_mm") ?? view.mapCloud;
    view.mapPayload = null;
  }
  const cloud = view.mapCloud;
  const about = cloud && Object.values(view.about).find(({ revision, points }) => revision === cloud.seq && points === cloud.labels.length);
  if (!about || (about === stitched.about && cloud === stitched.cloud)) return;
  try {
    stitched.draw(about, cloud);
  } catch {
    undecodable++;
    view.mapCloud = null;
  }
}

function updateObjects(cloud) {
  skin.setCloud(cloud);
  const { shown, more } = objectsIn(cloud?.labels ?? []), key = `${shown} ${more}`;
  if (key === $("objects").dataset.key) return;
  $("objects").dataset.key = key;
  const spans = shown.map((label) => element("span", {}, dotOf(label), `object ${label} `));
  if (more > 0) spans.push(element("span", {}, `and ${more} more`));
  $("objects").replaceChildren(...spans);
}

function updateFlags(flags) {
  const words = [];
  if (flags & INVALID) words.push("frame unusable");
  if (flags & SATURATED) words.push("deeper than calibrated: a lower bound");
  if (flags & DEGRADED) words.push("less certain");
  $("flags").textContent = words.join(", ");
}

// Texts.

function updateLink(level, words) {
  $("link").dataset.level = level;
  $("link").textContent = words;
  if (level === "good") $("login").hidden = true;
  if (level !== "good") rezero.cancel();
  if (chosen !== null) updateState();
  showTabs();
}

function updateState() {
  if (!works(chosen)) rezero.cancel();
  showState(sensors.get(chosen)?.state, view.parts, view.health, link?.connected, !works(chosen));
  $("sensor").classList.toggle("is-raw", uncalibrated());
  updateControls();
}

function updateHealth() {
  const camera = view.parts.get("camera"), asked = camera?.fps_asked ?? camera?.fps;
  showRates(view.health, asked);
  updateState();
  showHealth(view.health, asked, [
    ["maps drawn", drawn], ["maps replaced by a newer one before drawing", superseded], ["maps drawn per second", number(drawnPerSecond(), 1)],
    ["camera to screen, if both clocks agree", view.age_ms === null ? "" : `${number(view.age_ms)} ms`],
    ["messages that the page could not read", undecodable],
  ]);
  updateStale();
}

function drawnPerSecond() {
  const now = performance.now(), latest = drawTimes.filter((time) => now - time < 2000);
  return latest.length > 1 ? ((latest.length - 1) * 1000) / Math.max(now - latest[0], 1) : 0;
}

function updateStale() {
  const state = sensors.get(chosen)?.state, { gone, frames, health, words } = freshness(view, { connected: link?.connected, works: works(chosen), state, paused: isPaused(view.parts) });
  for (const [name, old] of [["is-stale", frames], ["is-unheard", health], ["is-gone", gone]]) $("sensor").classList.toggle(name, old);
  $("stale").hidden = words === "";
  $("stale").textContent = words;
}

setInterval(() => {
  whole.showState();
  if (chosen === null) return;
  updateHealth();
  schedule(); // in case a release was lost
}, 500);

function askLogin(why) {
  $("login-why").textContent = why;
  $("login").hidden = false;
  $("login").elements.username.focus();
}

$("login").addEventListener("submit", (event) => {
  event.preventDefault();
  const { username, password } = event.target.elements;
  link.login(username.value, password.value);
  password.value = "";
});

// Requests.

function updateControls() {
  const may = !READ_ONLY && link?.connected && works(chosen) && !asking && !uncalibrated(), able = may && !isPlayed(view.parts);
  updatePlayback(view.parts, works(chosen), may);
  $("rezero").disabled = !able && !(rezero.waiting && !rezero.taking);
  $("retired").hidden = !link?.connected || sensors.get(chosen)?.state === undefined || works(chosen);
  updateRecording(view.parts.get("recorder"), able);
  $("profile").disabled = !able || !sensors.get(chosen).info;
  updateSession(able);
}

/** Whether the sensor has reported that it has no geometry yet: then only its camera's picture is available. */
const uncalibrated = () => sensors.get(chosen)?.info?.geometry === null;

/** Update the buttons of a stitching session, for a sensor that publishes `status/stitching`. */
function updateSession(able) {
  const status = view.parts.get("stitching"), open = status?.state !== "idle", form = $("session");
  form.hidden = !status;
  if (!status) return;
  const { session, begin, add, end, abort } = form.elements;
  session.parentElement.hidden = begin.hidden = open;
  add.hidden = end.hidden = abort.hidden = !open;
  session.disabled = begin.disabled = !able;
  add.disabled = end.disabled = abort.disabled = !able || status.state !== "open";
  form.querySelector("output").textContent = open ? `Stitching ${status.name}: ${counted(status.presses, "press")}` : "";
}

function updateProfiles() {
  const info = sensors.get(chosen)?.info, choice = info?.choice ?? info?.profile; // an older daemon reports no choice
  const names = [...new Set([...(info?.profiles ?? []).filter((name) => name !== UNLISTED), ...(info ? [choice] : [])])];
  const label = (name) => (name === choice && choice !== info.profile ? `${name} (now ${info.profile})` : name);
  $("profile").replaceChildren(...names.map((name) => element("option", { textContent: label(name), value: name })));
  $("profile").value = choice ?? "";
}

function updateAnswer(level, words) {
  $("answer").dataset.level = level;
  $("answer").textContent = cut(words);
}

/** Send a request to the chosen sensor; resolves to the code of a refusal, empty on success. */
async function ask(verb, body, doing, done, answer_ms) {
  const sensor = chosen, say = (level, words) => {
    if (sensor !== chosen) return;
    updateAnswer(level, words);
  };
  let code = "";
  asking = true;
  updateControls();
  say("wait", doing);
  try {
    say("good", done(await link.request(sensor, verb, body, answer_ms)));
  } catch (error) {
    say("bad", error.message);
    code = error.code ?? "";
  }
  asking = false;
  updateControls();
  updateProfiles();
  return code;
}

$("profile").addEventListener("change", (event) => {
  const profile = event.target.value;
  ask("profile", { profile }, `Changing to ${profile} …`, (result) => `The profile is ${result.profile}.`);
});
$("rezero").addEventListener("click", () => {
  rezero.toggle(view.contact);
});
$("remove").addEventListener("click", () => retire(chosen));
$("restore").addEventListener("click", () => {
  restore();
  showTabs();
  if (chosen === null) choose([...sensors.keys()].sort()[0]);
});
commandPlayback((body) => ask("replay", body, "", (result) => {
  compare.follow(body, result);
  return "";
}));
commandRecordings((body, doing, done) => ask("record", body, doing, done));
$("session").addEventListener("submit", (event) => {
  event.preventDefault();
  const name = event.target.elements.session.value.trim();
  ask("stitch", name ? { action: "begin", name } : { action: "begin" }, "Beginning …", (result) => `Session ${result.name} is open: it adds every settled contact.`);
});
$("session").elements.add.addEventListener("click", () => {
  ask("stitch", { action: "add" }, "Adding …", (result) => `Added press ${result.press}.`);
});
$("session").elements.end.addEventListener("click", () => {
  ask("stitch", { action: "end" }, "Making the map …", (result) => `Made the map of ${result.name} from ${result.used} of ${counted(result.presses, "press")}.`, MAP_MS);
});
$("session").elements.abort.addEventListener("click", () => {
  const { name, presses } = view.parts.get("stitching");
  if (!confirm(`End ${name} without a map? This deletes its ${counted(presses, "press")}.`)) return;
  ask("stitch", { action: "abort" }, "Ending …", (result) => `Deleted session ${result.name}.`);
});

$("health").addEventListener("toggle", () => updateHealth());
$("read-only").hidden = !READ_ONLY;
$("range").value = stored("tacshade-range") ?? "auto";
if ($("range").value === "") $("range").value = "auto";
$("range").addEventListener("change", () => {
  store("tacshade-range", $("range").value);
  if (!view.map) return;
  heights.draw(view.map, view.drawnFor);
  skin.setSkin(view.map, view.drawnFor, heights.scale_mm);
  skin.render();
});

/** What the page shows, read-only, for tests and for the browser's console. */
window.tacshade = Object.freeze({
  get drawn() { return drawn; },
  get maps() { return { heard, drawn, superseded, waiting: view.height ? 1 : 0 }; },
  get arrows() { return arrows; },
  get slips() { return chart.slips.filter((depth) => depth !== null).length; },
  get undecodable() { return undecodable; },
  get sensor() { return chosen; },
  get seq() { return view.map?.seq ?? null; },
  get skinSeq() { return skin.seq; },
  get scale_mm() { return heights.scale_mm; },
  get age_ms() { return view.age_ms; },
  get compared() { return compare.seen; },
  get whole() { return whole.drawn; },
  get stitched() { return stitched.about; },
  get webgl() { return skin.available; },
  depthAt: (row, col) => heights.depthAt(row, col),
  drawnPeak: () => heights.drawnPeak(),
  zAt: (x_mm, y_mm) => stitched.zAt(x_mm, y_mm),
});
