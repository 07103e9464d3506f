// The draft of a correction: what was tracked, and over it what the user moved or marked in one frame.

import { BOX, emptyTarget, round, Store } from "./store.js";

// the members of a part's cell, as in api/rows
export const CELL = { x: 0, y: 1, w: 2, h: 3, confidence: 5, status: 6, byHand: 7, corners: 8 };

/** Where a cell has a part: [x, y] of a point, [left, top, width, height] of a box; null if it has no place. */
export function placeOf(cell, part) {
  if (!cell || cell[CELL.x] === null || cell[CELL.status] === "absent") return null;
  const [x, y, w, h] = cell;
  return part === BOX ? [x - (w - 1) / 2, y - (h - 1) / 2, w, h].map(round) : [x, y];
}

/** Whether a part should be reviewed, by what is reported of it. */
export const isUncertain = ({ kind, confidence, below }) => kind === "lost" || (confidence ?? 1) < below;

export class FixStore extends Store {
  rows = null; // a Rows, once it is there
  highlighted = null; // the slot because of which the frame is shown

  // --- what there is

  /** Points before the box in which all of them would be placed again. */
  slots() {
    return this.layout.flatMap(({ target, box, points }) => [
      ...points.map((part) => ({ target, part })),
      ...(box === "no" ? [] : [{ target, part: BOX }]),
    ]);
  }

  /** A slot's cell in the frame that is shown, null if it is not known (yet). */
  cell(slot) {
    return this.rows?.cell(this.frame, slot) ?? null;
  }

  /** Whether the box is that of all points, which has no place of its own. */
  isBoxOfPoints(slot) {
    return slot.part === BOX && this.group(slot.target).points.length > 0;
  }

  drafted(slot) {
    return this.isHere() ? super.value(slot) : null;
  }

  /** Whether the draft marks it as absent. */
  markedAbsent({ target, part }) {
    const absent = this.isHere() && this.draft.targets[target]?.absent;
    return absent === true || (!!absent && absent.includes(part));
  }

  value(slot) {
    if (!slot || this.markedAbsent(slot)) return null;
    return this.drafted(slot) ?? placeOf(this.cell(slot), slot.part);
  }

  /** {kind: marked, moved, init, tracked, hidden, lost, absent or unknown; confidence, byHand,
   * below: what a lost part's confidence is below} in the frame that is shown. */
  report(slot) {
    if (this.markedAbsent(slot)) return { kind: "marked" };
    if (this.drafted(slot)) return { kind: "moved" };
    const cell = this.cell(slot);
    if (!cell) return { kind: "unknown" };
    const below = this.session.lost_below[slot.target];
    return { kind: cell[CELL.status], confidence: cell[CELL.confidence], byHand: cell[CELL.byHand], below };
  }

  isAbsent(slot) {
    return ["marked", "absent"].includes(this.report(slot).kind);
  }

  /** The slots that a run has of a target. */
  parts(target) {
    const { points } = this.group(target);
    return (points.length ? points : [BOX]).map((part) => ({ target, part }));
  }

  /** The slots that a run has of all targets. */
  allParts() {
    return this.layout.flatMap(({ target }) => this.parts(target));
  }

  /** How many parts the draft changes, those in the box of all points included. */
  changed() {
    const boxed = ({ target }) => this.drafted({ target, part: BOX });
    return this.allParts().filter((slot) => this.drafted(slot) || this.markedAbsent(slot) || boxed(slot)).length;
  }

  /** Nothing is required: a click places a part only if it was chosen in the list. */
  nextMissing() {
    return null;
  }

  openSlot() {
    return this.current;
  }

  // --- selection

  deselect() {
    this.selected = this.current = this.highlighted = null;
  }

  #select(selected, current, highlighted) {
    Object.assign(this, { selected, current, highlighted });
    this.emit("draft");
  }

  select(slot) {
    this.#select(slot, null, null);
  }

  /** The next click in the frame places it. */
  choose(slot) {
    this.#select(slot, slot, null);
  }

  /** Shows a frame because of this slot. */
  jump(frame, slot = null) {
    this.show(frame);
    this.#select(null, null, slot);
  }

  // --- changes

  drag(slot, value) {
    this.selected = slot;
    this.highlighted = null;
    super.drag(slot, value);
  }

  put(draft, slot, value) {
    const one = (draft.targets[slot.target] ??= emptyTarget());
    if (slot.part === BOX) {
      one.box = value && value.map(round);
      if (value) Object.assign(one, { points: {}, absent: [] }); // all points are placed again
    } else if (value) {
      one.box = null;
      one.points[slot.part] = value.map(round);
    } else delete one.points[slot.part];
    if (value) this.#mark(one, slot, false);
    this.removeIfEmpty(draft, slot.target);
  }

  /** Marks slots of one target as absent, or removes the marks. */
  setAbsent(slots, absent) {
    this.change((draft) => {
      for (const slot of slots) {
        const one = (draft.targets[slot.target] ??= emptyTarget());
        if (absent) {
          delete one.points[slot.part];
          one.box = null;
        }
        this.#mark(one, slot, absent);
        this.removeIfEmpty(draft, slot.target);
      }
    });
    this.#select(slots.length > 1 ? null : slots[0], null, null); // so that the next key may revert it
  }

  /** Removes from the draft what it has of a slot. */
  revert(slot) {
    this.change((draft) => {
      this.#mark(draft.targets[slot.target], slot, false);
      this.put(draft, slot, null);
    });
    this.selected = slot;
    this.emit("draft");
  }

  discard() {
    this.change((draft) => {
      draft.targets = {};
    });
  }

  #mark(one, { target, part }, absent) {
    const all = this.parts(target).map((slot) => slot.part);
    const listed = new Set(one.absent === true ? all : one.absent);
    if (absent) listed.add(part);
    else listed.delete(part);
    one.absent = all.every((each) => listed.has(each)) ? true : all.filter((each) => listed.has(each));
  }

  /** What was tracked is no draft any more, and its steps cannot be undone here. */
  forget() {
    this.past = [];
    this.future = [];
    this.draft = { frame: this.frame, targets: {} };
    this.emit("draft");
  }
}
