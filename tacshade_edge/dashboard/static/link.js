// MQTT over the server that served this page, which forwards it to the broker; the link reconnects by itself.

import { cut } from "./bounds.js";
import { storeInTab, storedInTab } from "./stored.js";
import mqtt from "./vendor/mqtt.esm.js";

const RETRY_MS = 1000, CONNECT_MS = 5000, KEEPALIVE_S = 15, ANSWER_MS = 8000;
const NOT_AUTHORISED = [4, 5, 134, 135]; // CONNACK codes of MQTT 3.1.1 and 5
const KEPT = "tacshade-login";

export class Link {
  /**
   * reported(level, text): state of the connection; level is "good", "wait" or "bad".
   * refused(text): the broker requires another user or password.
   * message(topic, payload, retained): every message of the subscriptions; payload is a view into a larger buffer;
   * retained: whether the broker had stored the message before.
   */
  constructor({ reported, refused, message }) {
    this.reported = reported;
    this.refused = refused;
    this.message = message;
    this.waiting = new Map(); // transaction -> { resolve, reject, timer }
    this.topics = new Set();
    this.open(storedInTab(KEPT) ?? {});
  }

  get connected() {
    return this.client?.connected ?? false;
  }

  /** Connect with a user and password, and keep them until the tab is closed. */
  login(username, password) {
    const user = { username, password };
    storeInTab(KEPT, user);
    this.open(user);
  }

  open(user) {
    this.client?.end(true);
    const url = new URL("mqtt", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.search = url.hash = "";
    let reason = "";
    this.reported("wait", "Connecting …");
    const client = mqtt.connect(url.href, {
      ...user,
      clientId: `page-${crypto.getRandomValues(new Uint32Array(2)).join("-")}`, // read_only.py requires this prefix
      protocolVersion: 5, // needed for requests, and the only version that the demo's broker supports
      keepalive: KEEPALIVE_S,
      reconnectPeriod: RETRY_MS,
      connectTimeout: CONNECT_MS,
      queueQoSZero: false,
      resubscribe: false, // our own, below, also covers a client that a login replaces
      // Our own socket, since mqtt.js does not report why the server closed it.
      createWebsocket: (address, protocols) => {
        const socket = new WebSocket(address, protocols);
        socket.binaryType = "arraybuffer";
        socket.addEventListener("close", (event) => { reason = event.reason || "the dashboard's server does not answer or rejects this page (its log says why; reload to log in)"; });
        return socket;
      },
    });
    this.client = client;
    client.on("connect", () => {
      this.reported("good", "Connected");
      if (this.topics.size) client.subscribe([...this.topics], { qos: 0 });
    });
    client.on("message", (topic, payload, packet) => {
      if (!this.answered(topic, payload)) this.message(topic, payload, packet.retain);
    });
    client.on("close", () => {
      if (client !== this.client || client.disconnecting) return;
      // The socket's own event, with the reason, comes in the same turn of the event loop.
      setTimeout(() => {
        if (client === this.client && !client.connected && !client.disconnecting) this.reported("bad", `Not connected: ${reason}; trying again`);
      });
    });
    client.on("error", (error) => {
      if (client !== this.client || !NOT_AUTHORISED.includes(error.code)) return; // other errors close the connection, and are reported there
      client.end(true);
      storeInTab(KEPT, null);
      this.reported("bad", "The broker requires a user and password");
      this.refused(user.username === undefined ? "The broker requires a user and password." : "The broker rejected this user or password.");
    });
  }

  subscribe(...topics) {
    for (const topic of topics) this.topics.add(topic);
    if (this.connected) this.client.subscribe(topics, { qos: 0 });
  }

  unsubscribe(...topics) {
    for (const topic of topics) this.topics.delete(topic);
    if (this.connected) this.client.unsubscribe(topics);
  }

  /** Send a request to a sensor; resolves to its result, rejects with an Error that has a readable message and the `code`. */
  request(sensor, verb, body, answer_ms = ANSWER_MS) {
    if (!this.connected) return Promise.reject(new Error("not connected"));
    const transaction = `page-${crypto.getRandomValues(new Uint32Array(2)).join("-")}`;
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => {
        this.waiting.delete(transaction);
        reject(new Error(`no answer within ${answer_ms / 1000} s`));
      }, answer_ms);
      this.waiting.set(transaction, { resolve, reject, timer });
      // QoS 0: a request that cannot be sent now is dropped and reported. QoS 1 could re-zero the sensor much later.
      this.client.publish(`tacshade/${sensor}/req/${verb}`, JSON.stringify({ ...body, transaction }), { qos: 0 });
    });
  }

  answered(topic, payload) {
    if (!topic.includes("/res/")) return false;
    let reply;
    try {
      reply = JSON.parse(new TextDecoder().decode(payload));
    } catch {
      return true;
    }
    const asked = this.waiting.get(reply?.transaction);
    if (asked) {
      this.waiting.delete(reply.transaction);
      clearTimeout(asked.timer);
      if (reply.ok) asked.resolve(reply.result);
      else asked.reject(Object.assign(new Error(cut(String(reply.error))), { code: reply.reason_code }));
    }
    return true;
  }
}
