// The clip at its own speed: frames that do not come in time are left out, never queued.

import { $, icon } from "./dom.js";

export class Play {
  constructor(store) {
    this.store = store;
    this.on = false;
    this.button = $("play");
    this.button.addEventListener("click", () => this.toggle());
    // whoever goes elsewhere wants to look
    store.addEventListener("frame", () => this.on && !this.own && this.stop());
  }

  toggle() {
    if (this.on) return this.stop();
    const { store } = this;
    if (store.ended || store.live) return;
    if (store.frame >= store.bounds.last) store.show(store.bounds.first);
    this.on = true;
    this.from = store.frame;
    this.since = performance.now();
    this.#look();
    this.#tick();
  }

  stop() {
    if (!this.on) return;
    this.on = false;
    cancelAnimationFrame(this.due);
    this.#look();
  }

  #tick() {
    this.due = requestAnimationFrame((now) => {
      const { store } = this;
      const frame = this.from + Math.floor(((now - this.since) * store.session.fps) / 1000);
      this.own = true;
      store.show(Math.min(Math.max(frame, this.from), store.bounds.last));
      this.own = false;
      if (frame >= store.bounds.last || store.ended) this.stop();
      else if (this.on) this.#tick();
    });
  }

  #look() {
    this.button.replaceChildren(icon(this.on ? "pause" : "play"));
    this.button.setAttribute("aria-label", this.on ? "Pause" : "Play");
    this.button.title = this.on ? "Pause (K)" : "Play (K)";
  }
}
