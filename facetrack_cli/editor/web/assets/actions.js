// What can be done to parts from the list and by keys: choose, put in the middle, nudge, remove.

import { number, spoken } from "./dom.js";
import { colour } from "./draw.js";
import { BOX, LEAST_BOX, same } from "./store.js";

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

// What can be done to a part: put it somewhere, nudge, resize, remove. Within the picture, as the server will ask.

const clamp = (value, low, high) => Math.min(Math.max(value, low), Math.max(low, high));

/** A point on a pixel of the picture. */
export const inside = ([x, y], [width, height]) => [clamp(x, 0, width - 1), clamp(y, 0, height - 1)];

/** A box moved so that its centre is in the picture; its edges may stand out, as a face may. */
export function held([left, top, w, h], [width, height]) {
  return [clamp(left, -(w - 1) / 2, width - 1 - (w - 1) / 2), clamp(top, -(h - 1) / 2, height - 1 - (h - 1) / 2), w, h];
}

/** The box between two places, in whole pixels, both of them in it, cut to the picture. */
export function between(a, b, size) {
  const [ax, ay] = inside(a, size).map(Math.round);
  const [bx, by] = inside(b, size).map(Math.round);
  return [Math.min(ax, bx), Math.min(ay, by), Math.abs(ax - bx) + 1, Math.abs(ay - by) + 1];
}

/** A box whose edges moved: `sx`, `sy` say which, -1 left or top, 1 right or bottom, 0 neither. */
export function resized([left, top, w, h], [sx, sy], dx, dy, least = LEAST_BOX) {
  if (sx < 0) dx = Math.min(dx, w - least);
  if (sy < 0) dy = Math.min(dy, h - least);
  return [
    sx < 0 ? left + dx : left,
    sy < 0 ? top + dy : top,
    sx ? Math.max(w + sx * dx, Math.min(least, w)) : w,
    sy ? Math.max(h + sy * dy, Math.min(least, h)) : h,
  ];
}

/** As fine as can be seen: a quarter of a pixel where pixels are large. */
export function snapped([x, y], scale) {
  const step = scale >= 2 ? 0.25 : scale >= 1 ? 0.5 : 1;
  return [Math.round(x / step) * step, Math.round(y / step) * step];
}

/** Where a part is put by the keyboard: in the middle of its target's box, or of what is seen of the picture. */
export function middle(store, stage, slot) {
  const { width, height } = stage.box;
  const seen = inside(stage.spot(width / 2, height / 2), store.size).map(Math.round);
  if (slot.part !== BOX) {
    const box = store.draft.targets[slot.target]?.box;
    return box ? inside([box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2], store.size) : seen;
  }
  const side = Math.max(
    Math.round(Math.min(...store.size, width / stage.view.scale, height / stage.view.scale) / 3),
    8,
  );
  return [seen[0] - (side >> 1), seen[1] - (side >> 1), side, side];
}

/** Moves what is selected by (dx, dy) pixels; nudges of the same mark are one step of undo. */
export function nudge(store, dx, dy) {
  const slot = store.selected;
  const value = store.value(slot);
  if (!value) return false;
  const [x, y, ...rest] = value;
  const moved = rest.length ? held([x + dx, y + dy, ...rest], store.size) : inside([x + dx, y + dy], store.size);
  store.set(slot, moved, `nudge ${slot.target} ${slot.part}`);
  return true;
}

/** Moves the right and the bottom edge of the selected box. */
export function stretch(store, dx, dy) {
  const slot = store.selected;
  const value = slot?.part === BOX && store.value(slot);
  if (!value) return false;
  store.set(slot, held(resized(value, [1, 1], dx, dy), store.size), `stretch ${slot.target}`);
  return true;
}

export function remove(store, slot) {
  if (!store.value(slot)) return false;
  store.set(slot, null);
  store.current = slot;
  store.selected = null;
  store.emit("draft");
  return true;
}
