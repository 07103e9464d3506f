// Through the clip: slider, buttons, a field for the number of the frame; and playing it.

import { $, icon } from "./dom.js";

export class Clip {
  constructor(store) {
    this.store = store;
    this.slider = $("frame-slider");
    this.field = $("frame-number");
    this.slider.addEventListener("input", () => store.show(this.slider.valueAsNumber));
    this.field.addEventListener("change", () => {
      if (Number.isFinite(this.field.valueAsNumber)) store.show(this.field.valueAsNumber);
      this.update();
    });
    this.field.addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      // what is typed next are the keys of the page, not digits of a number
      this.field.dispatchEvent(new Event("change"));
      $("stage").focus({ preventScroll: true });
      event.preventDefault();
    });
    $("previous").addEventListener("click", () => this.by(-1));
    $("following").addEventListener("click", () => this.by(1));
    store.addEventListener("frame", () => this.update());
    this.update();
  }

  by(step) {
    this.store.show(this.store.frame + step);
  }

  update() {
    const { frame, bounds, session } = this.store;
    for (const input of [this.slider, this.field]) {
      input.min = bounds.first;
      input.max = bounds.last;
      if (input.valueAsNumber !== frame) input.value = frame;
    }
    this.slider.setAttribute("aria-valuetext", `frame ${frame}, ${clock(frame / session.fps)}`);
    $("last-frame").textContent = `of ${bounds.exact ? "" : "about "}${bounds.last}`;
    $("clock").textContent = clock(frame / session.fps);
    $("previous").disabled = frame <= bounds.first;
    $("following").disabled = frame >= bounds.last;
  }
}

/** Seconds as 1:02:03.4; hours only if there are any. */
function clock(seconds) {
  const tenths = Math.floor(seconds * 10 + 1e-6);
  const [h, m, s] = [Math.floor(tenths / 36000), Math.floor(tenths / 600) % 60, (tenths % 600) / 10];
  const two = (value) => String(value).padStart(2, "0");
  return `${h ? `${h}:${two(m)}` : m}:${s.toFixed(1).padStart(4, "0")}`;
}

/** Plays the clip at its own speed: frames whose images do not arrive in time are skipped. */
export class Play {
  constructor(store) {
    this.store = store;
    this.on = false;
    this.button = $("play");
    this.button.addEventListener("click", () => this.toggle());
    // any other change of the frame stops it
    store.addEventListener("frame", () => this.on && !this.own && this.stop());
  }

  toggle() {
    if (this.on) return this.stop();
    const { store } = this;
    if (store.ended || store.beforeGesture) return;
    if (store.frame >= store.bounds.last) store.show(store.bounds.first);
    this.from = store.frame;
    this.since = performance.now();
    this.#setOn(true);
    this.#tick();
  }

  stop() {
    if (!this.on) return;
    cancelAnimationFrame(this.due);
    this.#setOn(false);
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

  #setOn(on) {
    this.on = on;
    const text = on ? "Pause" : "Play";
    this.button.replaceChildren(icon(`icon-${text.toLowerCase()}`));
    this.button.setAttribute("aria-label", text);
    this.button.title = `${text} (K)`;
  }
}
