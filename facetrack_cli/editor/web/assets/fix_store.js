// Putting a run right: what was tracked, and over it the draft, which is what was put right by hand in one frame.

import { BOX, empty, round, same, Store } from "./store.js";

// places of a part's cell, as api/rows has it
export const CELL = { x: 0, y: 1, w: 2, h: 3, confidence: 5, status: 6, byHand: 7, corners: 8 };

/** Where a cell has a part: [x, y] of a point, [left, top, width, height] of a box; null if it is nowhere. */
export function placeOf(cell, part) {
  if (!cell || cell[CELL.x] === null || cell[CELL.status] === "absent") return null;
  const [x, y, w, h] = cell;
  return part === BOX ? [x - (w - 1) / 2, y - (h - 1) / 2, w, h].map(round) : [x, y];
}

export class FixStore extends Store {
  rows = null; // a Rows, once it is there
  looked = null; // the part that was jumped to
  busy = false; // while something is tracked

  // --- what there is

  /** Points before the box in which all of them would be placed anew. */
  slots() {
    return this.layout.flatMap(({ target, box, points }) => [
      ...points.map((part) => ({ target, part })),
      ...(box === "no" ? [] : [{ target, part: BOX }]),
    ]);
  }

  /** A part's cell in the frame that is shown, null if it is not known (yet). */
  cell(slot) {
    return this.rows?.cell(this.frame, slot) ?? null;
  }

  /** Whether the box is that of all points, which is nowhere by itself. */
  around(slot) {
    return slot.part === BOX && this.group(slot.target).points.length > 0;
  }

  drafted(slot) {
    return this.isHere() ? super.value(slot) : null;
  }

  /** Whether the draft says anything of it, the box of all points included. */
  spoken(slot) {
    return this.drafted(slot) || this.gone(slot) || this.drafted({ target: slot.target, part: BOX });
  }

  /** Whether the draft says that it is not there. */
  gone({ target, part }) {
    const absent = this.isHere() && this.draft.targets[target]?.absent;
    return absent === true || (!!absent && absent.includes(part));
  }

  value(slot) {
    if (!slot) return null;
    if (this.gone(slot)) return null;
    return this.drafted(slot) ?? placeOf(this.cell(slot), slot.part);
  }

  /** {kind: moved, gone, init, tracked, lost, absent or unknown; confidence, byHand} in the frame that is shown. */
  told(slot) {
    if (this.gone(slot)) return { kind: "gone" };
    if (this.drafted(slot)) return { kind: "moved" };
    const cell = this.cell(slot);
    if (!cell) return { kind: "unknown" };
    return { kind: cell[CELL.status], confidence: cell[CELL.confidence], byHand: cell[CELL.byHand] };
  }

  missing(slot) {
    return ["gone", "absent"].includes(this.told(slot).kind);
  }

  /** The parts that a run has of a target. */
  parts(target) {
    const { points } = this.group(target);
    return (points.length ? points : [BOX]).map((part) => ({ target, part }));
  }

  moved() {
    return this.layout.flatMap(({ target }) => this.parts(target)).filter((slot) => this.spoken(slot)).length;
  }

  /** Nothing is asked for: a part is placed by a click only if it was chosen in the list. */
  next() {
    return null;
  }

  open() {
    return this.current;
  }

  // --- selection

  leave() {
    this.selected = this.current = this.looked = null;
  }

  pick(slot) {
    this.selected = slot;
    this.current = null;
    this.looked = null;
    this.emit("draft");
  }

  /** The next click in the picture says where it is. */
  arm(slot) {
    this.selected = this.current = slot;
    this.looked = null;
    this.emit("draft");
  }

  /** Shows a frame because of this part of it. */
  jump(frame, slot = null) {
    this.show(frame);
    this.selected = this.current = null;
    this.looked = slot;
    this.emit("draft");
  }

  // --- changes

  drag(slot, value) {
    this.selected = slot;
    this.looked = null;
    super.drag(slot, value);
  }

  put(draft, slot, value) {
    const one = (draft.targets[slot.target] ??= empty());
    if (slot.part === BOX) {
      one.box = value && value.map(round);
      if (value) Object.assign(one, { points: {}, absent: [] }); // all of it is placed anew
    } else if (value) {
      one.box = null;
      one.points[slot.part] = value.map(round);
    } else delete one.points[slot.part];
    if (value) this.#lack(one, slot, false);
    this.#tidy(draft, slot.target);
  }

  /** Says that parts of one target are not there, or takes that back. */
  setAbsent(slots, absent) {
    this.change((draft) => {
      for (const slot of slots) {
        const one = (draft.targets[slot.target] ??= empty());
        if (absent) {
          delete one.points[slot.part];
          one.box = null;
        }
        this.#lack(one, slot, absent);
        this.#tidy(draft, slot.target);
      }
    });
    this.looked = this.current = null;
    this.selected = slots.length > 1 ? null : slots[0]; // so that the next key may take it back
    this.emit("draft");
  }

  /** Takes back what the draft says of a part. */
  takeBack(slot) {
    if (!this.drafted(slot) && !this.gone(slot)) return false;
    this.change((draft) => {
      const one = draft.targets[slot.target];
      this.#lack(one, slot, false);
      this.put(draft, slot, null);
    });
    this.selected = slot;
    this.emit("draft");
    return true;
  }

  throwAway() {
    if (this.isEmpty()) return false;
    this.change((draft) => {
      draft.targets = {};
    });
    return true;
  }

  #lack(one, { target, part }, absent) {
    const all = this.parts(target).map((slot) => slot.part);
    const listed = new Set(one.absent === true ? all : one.absent);
    if (absent) listed.add(part);
    else listed.delete(part);
    one.absent = all.every((each) => listed.has(each)) ? true : all.filter((each) => listed.has(each));
  }

  #tidy(draft, target) {
    const { box, points, absent } = draft.targets[target];
    if (!box && !Object.keys(points).length && absent !== true && !absent.length) delete draft.targets[target];
  }

  follow() {} // the page tells of what is moved elsewhere

  /** What was tracked is no draft any more, and nothing of it to be undone here. */
  adopt(draft) {
    super.adopt(draft);
    if (!this.isEmpty()) return;
    this.past = [];
    this.future = [];
    this.emit("draft");
  }

  isSelected(slot) {
    return same(this.selected, slot);
  }
}
