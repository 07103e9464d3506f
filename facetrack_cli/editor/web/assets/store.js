// What is chosen so far (the draft), what is wanted, what is selected; undo and redo. Knows neither page nor server.

import { arranged, stranger } from "./layout.js";

export const BOX = "box";
export const LEAST_BOX = 6; // pixels of a side, as the server has it
const MERGED = 1000; // ms: nudges that follow each other as fast are one step of undo
const MOST_STEPS = 500;

export const same = (a, b) => a === b || (!!a && !!b && a.target === b.target && a.part === b.part);
export const round = (value) => Math.round(value * 100) / 100;

export const empty = () => ({ box: null, points: {}, absent: [] });

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
    this.layout = arranged(session, draft);
    this.past = [];
    this.future = [];
    this.live = null; // the state before a gesture that is under way
    this.current = null; // the part that a click places
    this.selected = null; // the mark that arrow keys nudge
    this.proposals = [];
    this.ended = false;
    this.current = this.next();
  }

  emit(what) {
    this.dispatchEvent(new Event(what));
  }

  // --- what there is

  /** All parts in the order of the list: {target, part}. */
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

  optional(slot) {
    const group = this.group(slot.target);
    return slot.part === BOX ? group.box !== "needed" : group.extra.includes(slot.part);
  }

  isEmpty() {
    return Object.values(this.draft.targets).every(
      (target) => !target.box && !Object.keys(target.points).length && target.absent !== true && !target.absent?.length,
    );
  }

  /** Whether what is done now belongs to the frame that is shown: a start is of one frame. */
  isHere() {
    return this.isEmpty() || this.draft.frame === this.frame;
  }

  /** The part that a click on free ground places, null if that moves the picture. */
  open() {
    return this.current && !this.value(this.current) ? this.current : null;
  }

  /** The first part that is needed and lacking, from the one after `slot` on, then from the top; null if none is. */
  next(slot = null) {
    const all = this.slots();
    const from = all.findIndex((one) => same(one, slot)) + 1;
    const lacking = [...all.slice(from), ...all.slice(0, from)].filter((one) => !this.value(one));
    const first = this.isEmpty() ? (lacking[0] ?? null) : null;
    return lacking.find((one) => !this.optional(one)) ?? first;
  }

  progress() {
    const all = this.slots();
    const needed = all.filter((slot) => !this.optional(slot) || this.value(slot));
    return { done: needed.filter((slot) => this.value(slot)).length, of: needed.length };
  }

  // --- the frame

  /** Called before another frame is shown. */
  leave() {}

  show(frame) {
    const { first, last } = this.bounds;
    frame = Math.min(Math.max(Math.round(frame), first), last);
    if (!Number.isFinite(frame) || frame === this.frame) return;
    this.leave();
    this.frame = frame;
    if (this.isEmpty()) this.draft.frame = frame; // nothing belongs to a frame yet
    this.emit("frame");
  }

  bound(frames) {
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
    else this.past.push({ ...before, merge, at: now, selected: this.selected });
    if (this.past.length > MOST_STEPS) this.past.shift();
    this.future = [];
  }

  /** One step of undo: `edit` changes the draft or the layout in place. Steps of one `merge` in a row are one. */
  change(edit, merge = "") {
    if (this.ended) return;
    const before = this.#snapshot();
    if (this.isEmpty()) this.draft.frame = this.frame;
    edit(this.draft, this.layout);
    this.#remember(before, merge);
    this.#settle(); // what is selected may be there no more
    this.emit("draft");
    this.emit("commit");
  }

  /** A gesture begins: what `drag` does is one step, or none if it is cancelled. */
  begin() {
    this.live = this.#snapshot();
    if (this.isEmpty()) this.draft.frame = this.frame;
  }

  drag(slot, value) {
    this.put(this.draft, slot, value);
    this.emit("draft");
  }

  commit() {
    const before = this.live;
    this.live = null;
    if (!before) return;
    if (JSON.stringify(before.draft) !== JSON.stringify(this.draft)) {
      this.#remember(before, "");
      this.emit("commit");
    }
    this.emit("draft");
  }

  cancel() {
    if (!this.live) return;
    Object.assign(this, this.live);
    this.live = null;
    this.emit("draft");
  }

  /** Puts a part into a draft, or takes it out of it (null). */
  put(draft, slot, value) {
    const target = (draft.targets[slot.target] ??= empty());
    if (slot.part === BOX) target.box = value && value.map(round);
    else if (value) target.points[slot.part] = value.map(round);
    else delete target.points[slot.part];
    if (!value && !target.box && !Object.keys(target.points).length && !this.group(slot.target)?.added) {
      delete draft.targets[slot.target];
    }
  }

  set(slot, value, merge = "") {
    this.change((draft) => this.put(draft, slot, value), merge);
  }

  /** Takes all of a proposal; `as` gives its only target another name. */
  take(proposal, as = null) {
    this.change((draft, layout) => {
      for (const [name, given] of Object.entries(proposal.targets)) {
        const target = as ?? name;
        if (!this.group(target)) layout.push(stranger(this.session, target));
        draft.targets[target] = { ...empty(), box: given.box ?? null, points: { ...given.points } };
      }
    });
    this.selected = null;
    this.current = this.next();
    this.emit("draft");
  }

  beginHere() {
    this.change((draft) => {
      draft.frame = this.frame;
    });
  }

  // --- targets of the user's own

  addTarget(name) {
    this.change((draft, layout) => {
      layout.push(stranger(this.session, name));
      draft.targets[name] = empty();
    });
    this.pick(this.slots().find((slot) => slot.target === name) ?? null);
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
      layout.splice(
        layout.findIndex((one) => one.target === name),
        1,
      );
      delete draft.targets[name];
    });
  }

  // --- selection

  pick(slot) {
    this.selected = slot;
    if (slot) this.current = slot;
    this.emit("draft");
  }

  /** The part that was chosen in the list. */
  arm(slot) {
    this.pick(slot);
  }

  /** After a part was placed: it stays selected for the arrow keys, the next one that is lacking becomes current. */
  advance(slot) {
    this.selected = slot;
    this.current = this.next(slot);
    this.emit("draft");
  }

  #settle() {
    const all = this.slots();
    const known = (slot) => (all.some((one) => same(one, slot)) ? slot : null);
    this.selected = this.value(known(this.selected)) ? this.selected : null;
    const current = known(this.current);
    this.current = current && (!this.value(current) || same(current, this.selected)) ? current : this.next();
  }

  // --- undo

  undo() {
    return this.#step(this.past, this.future);
  }

  redo() {
    return this.#step(this.future, this.past);
  }

  #step(from, to) {
    if (this.ended || this.live || !from.length) return false;
    const { draft, layout } = from.pop();
    to.push({ ...this.#snapshot(), merge: "", at: 0 });
    Object.assign(this, { draft, layout });
    this.#settle();
    if (!this.isEmpty() && draft.frame !== this.frame) this.show(draft.frame);
    this.emit("draft");
    this.emit("commit");
    return true;
  }

  /** Takes over what another window made of it; undo brings back what was here. */
  adopt(draft) {
    this.#remember(this.#snapshot(), "");
    this.live = null;
    const wasHere = this.isHere();
    this.draft = structuredClone(draft);
    this.layout = arranged(this.session, this.draft);
    this.#settle();
    if (this.isEmpty()) this.draft.frame = this.frame;
    else if (wasHere) this.follow();
    this.emit("draft");
  }

  /** Goes along with another window to the frame of what it changed. */
  follow() {
    this.show(this.draft.frame);
  }
}
