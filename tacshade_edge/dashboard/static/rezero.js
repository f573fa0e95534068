// A new zero, once nothing touches. The page waits, not the sensor: if it closes or loses its connection, nothing was requested.

const REST_MS = 500;

export class Rezero {
  /** ask(): takes the new zero; resolves to the reason code of a refusal. changed(words): called on every change. */
  constructor({ ask, changed }) {
    this.ask = ask;
    this.changed = changed;
    this.waiting = false;
    this.rest_ms = null; // since when nothing touches
  }

  /** Handle a click: take the zero, wait for a rest, or stop waiting. */
  toggle(contact) {
    if (this.waiting) return this.cancel();
    this.waiting = true;
    this.rest_ms = null;
    if (contact === null || rests(contact)) this.take();
    else this.changed();
  }

  cancel() {
    if (!this.waiting || this.taking) return;
    this.waiting = false;
    this.changed("Cancelled: no new zero.");
  }

  /** Process the current contact. */
  heard(contact) {
    if (!this.waiting || this.taking) return;
    if (!rests(contact)) this.rest_ms = null;
    else this.rest_ms ??= performance.now();
    if (this.rest_ms !== null && performance.now() - this.rest_ms >= REST_MS) this.take();
  }

  async take() {
    this.taking = true;
    this.changed();
    const code = await this.ask();
    this.taking = false;
    this.rest_ms = null;
    if (code !== "frame_in_contact") this.waiting = false; // touched in the meantime: wait for the next rest
    this.changed();
  }
}

const rests = (contact) => contact.contact === 0 && !contact.touched && !contact.reason_code;
