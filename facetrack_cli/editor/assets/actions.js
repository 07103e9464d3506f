// What the keys and the list do to parts: choose, place in the middle, nudge, resize, remove.

import { formatNumber, readable, say } from "./dom.js";
import { colour } from "./draw.js";
import { centreOf, clampBox, clampPoint, resizeBox } from "./geometry.js";
import { BOX, sameSlot } from "./store.js";

const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
export const LONG_STEP = 25; // frames

export class Actions {
  constructor({ store, stage, magnifier, gestures, clip, mode }) {
    Object.assign(this, { store, stage, magnifier, gestures, clip, mode });
    this.fixes = store.mode === "fix";
  }

  #place(slot) {
    const { store } = this;
    if (!this.mode.canEdit(true)) return;
    store.set(slot, this.#defaultValue(slot));
    store.advance(slot);
    this.#show(slot);
  }

  // in the middle of its target's box, or of the visible part of the frame
  #defaultValue(slot) {
    const { store, stage } = this;
    const { width, height } = stage.box;
    const middle = clampPoint(stage.toImage(width / 2, height / 2), store.size).map(Math.round);
    if (slot.part !== BOX) {
      const box = store.draft.targets[slot.target]?.box;
      return box ? clampPoint(centreOf(box), store.size) : middle;
    }
    const { scale } = stage.view;
    const side = Math.max(Math.round(Math.min(...store.size, width / scale, height / scale) / 3), 8);
    return [middle[0] - (side >> 1), middle[1] - (side >> 1), side, side];
  }

  // shows where a slot is
  #show(slot) {
    const { store } = this;
    const value = store.value(slot);
    if (!value) return;
    if (slot.part !== BOX) {
      this.stage.reveal(...value);
      this.magnifier.show(...value, "keys", colour(store, slot.target, slot.part));
      this.magnifier.hide(2500);
    }
    const kind = this.fixes && slot.part !== BOX ? "quiet" : "info"; // the magnifier shows it, too
    say(`${readable(slot.part)} of ${readable(slot.target)} at ${value.map(formatNumber).join(", ")}`, kind);
  }

  /** A part of the list; if it was chosen by a key and has no place, it is placed in the middle. */
  choose(slot, byKey) {
    const { store } = this;
    if (store.ended) return;
    store.choose(slot);
    if (byKey && !store.value(slot)) this.#place(slot);
    else this.#show(slot);
    this.stage.canvas.focus({ preventScroll: true });
  }

  #select(slot) {
    this.store.select(slot);
    this.#show(slot);
    this.stage.canvas.focus({ preventScroll: true });
  }

  /** Enter on the image. */
  enter() {
    const { store } = this;
    if (store.ended || ![this.stage.canvas, document.body].includes(document.activeElement)) return false;
    const open = store.current && !store.value(store.current) ? store.current : store.nextMissing(store.selected);
    if (open) this.#place(open);
    else if (!this.fixes)
      say("All parts are placed. Ctrl+S saves."); // Enter itself never saves
    else if (store.highlighted) this.#select(store.highlighted);
    else say(store.isEmpty() ? "N goes to the next frame to review." : "Ctrl+Enter tracks from here.");
    return true;
  }

  arrow(event) {
    const { store } = this;
    const [dx, dy] = DIRECTIONS[event.key];
    const slot = store.value(store.selected) ? store.selected : null;
    const ctrl = event.ctrlKey || event.metaKey;
    if (!slot) return dx && !ctrl && !event.altKey ? this.clip.by(dx * (event.shiftKey ? LONG_STEP : 1)) : false;
    if (!this.mode.canEdit(true)) return true;
    if (ctrl && slot.part !== BOX) return false;
    const step = event.shiftKey ? 10 : event.altKey ? 0.25 : 1;
    const [x, y, ...rest] = store.value(slot);
    const moved = [x + dx * step, y + dy * step, ...rest];
    const resized = () => resizeBox([x, y, ...rest], [1, 1], dx * step, dy * step);
    const value = rest.length ? clampBox(ctrl ? resized() : moved, store.size) : clampPoint(moved, store.size);
    // successive nudges of the same slot are one step of undo
    store.set(slot, value, `${ctrl ? "resize" : "nudge"} ${slot.target} ${slot.part}`);
    this.#show(slot);
    return true;
  }

  /** To the next part, or the one before. */
  step(by) {
    const { store } = this;
    const all = store.slots();
    const from = store.selected ?? store.current ?? store.highlighted;
    const at = all.findIndex((slot) => sameSlot(slot, from));
    const slot = all[at < 0 && by < 0 ? all.length - 1 : (at + by + all.length) % all.length];
    if (!slot) return;
    if (this.fixes && store.value(slot)) this.#select(slot);
    else this.choose(slot, false);
  }

  /** Removes a mark; in a run it is again as it was tracked. */
  remove(slot = this.store.selected ?? this.store.highlighted) {
    const { store } = this;
    const marked = slot && (this.fixes ? store.drafted(slot) || store.markedAbsent(slot) : store.value(slot));
    if (!marked || !this.mode.canEdit(true)) return false;
    if (this.fixes) {
      store.revert(slot);
      say(`${readable(slot.part)} of ${readable(slot.target)} is as it was tracked.`);
    } else {
      store.set(slot, null);
      Object.assign(store, { current: slot, selected: null });
      store.emit("draft");
    }
    return true;
  }

  escape() {
    const { store } = this;
    if (store.beforeGesture) return this.gestures.cancel();
    this.magnifier.hide();
    if (this.fixes) store.select(null);
    else {
      store.selected = null;
      if (store.value(store.current)) store.current = store.nextMissing();
      store.emit("draft");
    }
    return true;
  }
}
