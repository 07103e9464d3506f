// What can be done to parts from the list and by keys: choose, put in the middle, nudge, remove.

import { number, spoken } from "./dom.js";
import { colour } from "./draw.js";
import { middle, nudge, remove, stretch } from "./edit.js";
import { BOX, same } from "./store.js";

const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
export const FAR = 25; // frames of a long step

export class Deeds {
  constructor({ store, stage, magnifier, gestures, clip, mode, say }) {
    Object.assign(this, { store, stage, magnifier, gestures, clip, mode, say });
  }

  place(slot) {
    const { store } = this;
    if (!this.mode.may(true)) return;
    store.set(slot, middle(store, this.stage, slot));
    store.advance(slot);
    this.tell(slot);
  }

  tell(slot) {
    const { store } = this;
    const value = store.value(slot);
    if (!value) return;
    if (slot.part !== BOX) {
      this.stage.reveal(...value);
      this.magnifier.show(...value, "keys", colour(store, slot.target));
      this.magnifier.hide(2500);
    }
    // the magnifier says it, too
    const kind = store.mode === "fix" && slot.part !== BOX ? "quiet" : "info";
    this.say(`${spoken(slot.part)} of ${spoken(slot.target)} at ${value.map(number).join(", ")}`, kind);
  }

  /** A part of the list; by a key also put in the middle, if it is nowhere. */
  choose(slot, byKey) {
    const { store } = this;
    if (store.ended) return;
    store.arm(slot);
    if (byKey && !store.value(slot)) this.place(slot);
    else this.tell(slot);
    this.stage.canvas.focus({ preventScroll: true });
  }

  /** Enter on the picture. */
  enter() {
    const { store } = this;
    if (store.ended || ![this.stage.canvas, document.body].includes(document.activeElement)) return false;
    if (store.mode === "fix") {
      if (store.current && !store.value(store.current)) this.place(store.current);
      else if (store.looked) this.#select(store.looked);
      else this.say(store.isEmpty() ? "N goes to the next doubtful frame." : "Ctrl+Enter tracks from here.");
      return true;
    }
    const open = store.current && !store.value(store.current) ? store.current : store.next(store.selected);
    if (open) this.place(open);
    else this.say("All is there. Ctrl+S saves."); // never by one Enter too many
    return true;
  }

  arrow(event) {
    const { store } = this;
    const [dx, dy] = WAYS[event.key];
    const selected = store.value(store.selected) ? store.selected : null;
    if (!selected) return dx && !event.ctrlKey && !event.altKey ? this.clip.by(dx * (event.shiftKey ? FAR : 1)) : false;
    if (!this.mode.may(true)) return true;
    const step = event.shiftKey ? 10 : event.altKey ? 0.25 : 1;
    if (event.ctrlKey || event.metaKey) {
      if (selected.part !== BOX) return false;
      stretch(store, dx * step, dy * step);
    } else nudge(store, dx * step, dy * step);
    this.tell(selected);
    return true;
  }

  /** To the next part, or the one before. */
  step(by) {
    const { store } = this;
    const all = store.slots();
    const from = store.selected ?? store.current ?? store.looked;
    const at = all.findIndex((slot) => same(slot, from));
    const slot = all[at < 0 && by < 0 ? all.length - 1 : (at + by + all.length) % all.length];
    if (!slot) return;
    if (store.mode === "fix" && store.value(slot)) this.#select(slot);
    else this.choose(slot, false);
  }

  #select(slot) {
    this.store.pick(slot);
    this.tell(slot);
    this.stage.canvas.focus({ preventScroll: true });
  }

  remove() {
    const { store } = this;
    const slot = store.selected ?? store.looked;
    if (store.mode === "pick") return store.value(slot) && this.mode.may(true) && remove(store, slot);
    if (!slot || !(store.drafted(slot) || store.gone(slot)) || !this.mode.may(true)) return false;
    store.takeBack(slot);
    this.say(`${spoken(slot.part)} of ${spoken(slot.target)} is as it was tracked.`);
    return true;
  }

  escape() {
    const { store } = this;
    if (store.live) return this.gestures.cancel();
    this.magnifier.hide();
    if (store.mode === "fix") store.pick(null);
    else {
      store.selected = null;
      if (store.value(store.current)) store.current = store.next();
      store.emit("draft");
    }
    return true;
  }
}
