// The draft, what is required, what is selected; undo and redo. It knows neither the page nor the server.

import { clamp } from "./geometry.js";
import { addedGroup, groupsOf } from "./layout.js";

export const BOX = "box";
const MERGED = 1000; // ms: nudges that follow each other as fast are one step of undo
const MOST_STEPS = 500;

/** A slot is a part of a target: {target, part}. */
export const sameSlot = (a, b) => a === b || (!!a && !!b && a.target === b.target && a.part === b.part);
export const slotId = (slot) => (slot ? `${slot.target}/${slot.part}` : "");
export const round = (value) => Math.round(value * 100) / 100;
export const emptyTarget = () => ({ box: null, points: {}, absent: [] });
const isEmptyTarget = ({ box, points, absent }) =>
  !box && !Object.keys(points).length && absent !== true && !absent?.length;

/** Events: "draft" (anything that is drawn or listed), "frame", "commit" (the draft is to be sent). */
export class Store extends EventTarget {
  constructor(session, draft) {
    super();
    this.session = session;
    this.mode = session.mode;
    this.size = session.size;
    this.bounds = session.frames;
    this.frame = draft.frame;
    this.draft = draft;
    this.layout = groupsOf(session, draft);
    this.past = [];
    this.future = [];
    this.beforeGesture = null; // the state before a gesture that has not ended
    this.current = null; // the slot that a click places
    this.selected = null; // the slot that arrow keys nudge
    this.proposals = [];
    this.busy = false; // while something is tracked
    this.ended = false;
    this.current = this.nextMissing();
  }

  emit(what) {
    this.dispatchEvent(new Event(what));
  }

  // --- what there is

  /** All slots in the order of the list. */
  slots() {
    return this.layout.flatMap(({ target, box, points }) => [
      ...(box === "no" ? [] : [{ target, part: BOX }]),
      ...points.map((part) => ({ target, part })),
    ]);
  }

  value(slot) {
    const target = slot && this.draft.targets[slot.target];
    if (!target) return null;
    return slot.part === BOX ? target.box : (target.points[slot.part] ?? null);
  }

  group(target) {
    return this.layout.find((one) => one.target === target);
  }

  isOptional(slot) {
    const group = this.group(slot.target);
    return slot.part === BOX ? group.box !== "needed" : group.extra.includes(slot.part);
  }

  isEmpty() {
    return Object.values(this.draft.targets).every(isEmptyTarget);
  }

  /** Whether a change now belongs to the frame that is shown: a draft is of one frame. */
  isHere() {
    return this.isEmpty() || this.draft.frame === this.frame;
  }

  /** The slot that a click on the frame places; null if a drag moves the image. */
  openSlot() {
    return this.current && !this.value(this.current) ? this.current : null;
  }

  /** The first required slot without a value, from the one after `slot` on, then from the top; null if there is none. */
  nextMissing(slot = null) {
    const all = this.slots();
    const from = all.findIndex((one) => sameSlot(one, slot)) + 1;
    const missing = [...all.slice(from), ...all.slice(0, from)].filter((one) => !this.value(one));
    const first = this.isEmpty() ? (missing[0] ?? null) : null;
    return missing.find((one) => !this.isOptional(one)) ?? first;
  }

  progress() {
    const needed = this.slots().filter((slot) => !this.isOptional(slot) || this.value(slot));
    return { done: needed.filter((slot) => this.value(slot)).length, of: needed.length };
  }

  // --- the frame

  /** Called before another frame is shown. */
  deselect() {}

  show(frame) {
    const { first, last } = this.bounds;
    frame = clamp(Math.round(frame), first, last);
    if (!Number.isFinite(frame) || frame === this.frame) return;
    this.deselect();
    this.frame = frame;
    if (this.isEmpty()) this.draft.frame = frame; // nothing belongs to a frame yet
    this.emit("frame");
  }

  showDraftFrame() {
    if (!this.isEmpty()) this.show(this.draft.frame);
  }

  setBounds(frames) {
    if (frames.last === this.bounds.last && frames.first === this.bounds.first) return;
    this.bounds = frames;
    this.show(this.frame);
    this.emit("frame");
  }

  // --- changes

  #snapshot() {
    return structuredClone({ draft: this.draft, layout: this.layout });
  }

  #remember(before, merge) {
    const top = this.past.at(-1);
    const now = performance.now();
    if (merge && top?.merge === merge && now - top.at < MERGED) top.at = now;
    else this.past.push({ ...before, merge, at: now });
    if (this.past.length > MOST_STEPS) this.past.shift();
    this.future = [];
  }

  /** One step of undo: `edit` changes the draft or the layout in place. Successive steps of one `merge` are one. */
  change(edit, merge = "") {
    if (this.ended) return;
    const before = this.#snapshot();
    if (this.isEmpty()) this.draft.frame = this.frame;
    edit(this.draft, this.layout);
    this.#remember(before, merge);
    this.#checkSelection();
    this.emit("draft");
    this.emit("commit");
  }

  /** A gesture begins: what `drag` changes is one step, or none if it is cancelled. */
  begin() {
    this.beforeGesture = this.#snapshot();
    if (this.isEmpty()) this.draft.frame = this.frame;
  }

  drag(slot, value) {
    this.put(this.draft, slot, value);
    this.emit("draft");
  }

  commit() {
    const before = this.beforeGesture;
    this.beforeGesture = null;
    if (!before) return;
    if (JSON.stringify(before.draft) !== JSON.stringify(this.draft)) {
      this.#remember(before, "");
      this.emit("commit");
    }
    this.emit("draft");
  }

  cancel() {
    if (!this.beforeGesture) return;
    Object.assign(this, this.beforeGesture);
    this.beforeGesture = null;
    this.emit("draft");
  }

  /** Puts a value into a draft, or removes it (null). */
  put(draft, slot, value) {
    const target = (draft.targets[slot.target] ??= emptyTarget());
    if (slot.part === BOX) target.box = value && value.map(round);
    else if (value) target.points[slot.part] = value.map(round);
    else delete target.points[slot.part];
    if (!value && !this.group(slot.target)?.added) this.removeIfEmpty(draft, slot.target);
  }

  removeIfEmpty(draft, target) {
    if (isEmptyTarget(draft.targets[target])) delete draft.targets[target];
  }

  set(slot, value, merge = "") {
    this.change((draft) => this.put(draft, slot, value), merge);
  }

  /** Takes all of a proposal; `as` gives its only target another name. */
  take(proposal, as = null) {
    this.change((draft, layout) => {
      for (const [name, given] of Object.entries(proposal.targets)) {
        const target = as ?? name;
        if (!this.group(target)) layout.push(addedGroup(this.session, target));
        draft.targets[target] = { ...emptyTarget(), box: given.box ?? null, points: { ...given.points } };
      }
    });
    this.selected = null;
    this.current = this.nextMissing();
    this.emit("draft");
  }

  beginHere() {
    this.change((draft) => {
      draft.frame = this.frame;
    });
  }

  // --- targets that the user adds

  addTarget(name) {
    this.change((draft, layout) => {
      layout.push(addedGroup(this.session, name));
      draft.targets[name] = emptyTarget();
    });
    this.select(this.slots().find((slot) => slot.target === name) ?? null);
  }

  rename(from, to) {
    this.change((draft, layout) => {
      layout.find((one) => one.target === from).target = to;
      const entries = Object.entries(draft.targets).map(([name, value]) => [name === from ? to : name, value]);
      draft.targets = Object.fromEntries(entries);
      const renamed = (slot) => (slot?.target === from ? { ...slot, target: to } : slot);
      [this.current, this.selected] = [renamed(this.current), renamed(this.selected)];
    });
  }

  removeTarget(name) {
    this.change((draft, layout) => {
      const at = layout.findIndex((one) => one.target === name);
      layout.splice(at, 1);
      delete draft.targets[name];
    });
  }

  // --- selection

  select(slot) {
    this.selected = slot;
    if (slot) this.current = slot;
    this.emit("draft");
  }

  /** The slot was chosen in the list. */
  choose(slot) {
    this.select(slot);
  }

  /** After a slot was placed: it stays selected for the arrow keys, the next missing one becomes current. */
  advance(slot) {
    this.selected = slot;
    this.current = this.nextMissing(slot);
    this.emit("draft");
  }

  // what is selected may not exist any more
  #checkSelection() {
    const all = this.slots();
    const known = (slot) => (all.some((one) => sameSlot(one, slot)) ? slot : null);
    this.selected = this.value(known(this.selected)) ? this.selected : null;
    const current = known(this.current);
    const stays = current && (!this.value(current) || sameSlot(current, this.selected));
    this.current = stays ? current : this.nextMissing();
  }

  // --- undo

  undo() {
    return this.#step(this.past, this.future);
  }

  redo() {
    return this.#step(this.future, this.past);
  }

  #step(from, to) {
    if (this.ended || this.busy || this.beforeGesture || !from.length) return false;
    const { draft, layout } = from.pop();
    to.push({ ...this.#snapshot(), merge: "", at: 0 });
    Object.assign(this, { draft, layout });
    this.#checkSelection();
    this.showDraftFrame();
    this.emit("draft");
    this.emit("commit");
    return true;
  }
}
