// The rows of the run: fetched in blocks around the frame that is shown, and a few of them kept.

import * as api from "./api.js";

const BLOCK = 100; // frames; the server gives 600 at most
const MOST = 24; // blocks kept
const AGAIN = 1500; // ms after nobody answered

export class Rows {
  constructor(store, onrows) {
    this.store = store;
    this.on = onrows;
    this.blocks = new Map(); // number -> {revision, frames}, the oldest first
    this.columns = new Map(); // "target/part" -> place in a frame
    this.revision = 0;
    this.asked = false;
    store.addEventListener("frame", () => this.#ask());
  }

  /** Takes the rows for others from now on; those of before are shown until the new ones are there. */
  renew(revision) {
    this.revision = revision;
    this.#ask();
  }

  /** The cells of a frame, null if they are not here. */
  frame(index) {
    const block = this.blocks.get(Math.floor(index / BLOCK));
    return block?.frames.get(index) ?? null;
  }

  cell(index, { target, part }) {
    const column = this.columns.get(`${target}/${part}`);
    return column === undefined ? null : (this.frame(index)?.[column] ?? null);
  }

  /** Whether the rows of a frame are here, and as they are now. */
  fresh(index) {
    return this.blocks.get(Math.floor(index / BLOCK))?.revision === this.revision;
  }

  // the block that is shown, then those beside it
  #next() {
    const { frame, bounds } = this.store;
    const at = Math.floor(frame / BLOCK);
    const last = Math.floor(bounds.last / BLOCK);
    const near = [at, frame % BLOCK >= BLOCK / 2 ? at + 1 : at - 1];
    return near.find(
      (block) =>
        block >= Math.floor(bounds.first / BLOCK) &&
        block <= last &&
        this.blocks.get(block)?.revision !== this.revision,
    );
  }

  async #ask() {
    clearTimeout(this.timer);
    const block = this.#next();
    if (this.asked || block === undefined || this.store.ended) return;
    this.asked = true;
    const revision = this.revision;
    const { first, last } = this.store.bounds;
    const from = Math.max(block * BLOCK, first);
    const to = Math.min((block + 1) * BLOCK - 1, last);
    let wait = 0;
    try {
      const got = await api.get(`rows?from=${from}&to=${to}`);
      this.columns = new Map(got.parts.map(([target, part], column) => [`${target}/${part}`, column]));
      this.blocks.delete(block);
      this.blocks.set(block, { revision, frames: new Map(got.frames.map((cells, i) => [got.from + i, cells])) });
      if (this.blocks.size > MOST) this.blocks.delete(this.blocks.keys().next().value);
      this.on();
    } catch {
      wait = AGAIN; // the page tells by itself that nobody answers
    }
    this.asked = false;
    this.timer = setTimeout(() => this.#ask(), wait);
  }
}
