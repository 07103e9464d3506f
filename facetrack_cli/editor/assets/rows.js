// The rows of the run: requested in blocks around the frame that is shown; some of them are kept.

import * as api from "./api.js";
import { slotId } from "./store.js";

const BLOCK = 100; // frames; the server sends 600 at most
const MOST = 24; // blocks kept
const RETRY = 1500; // ms after a request failed

const blockOf = (index) => Math.floor(index / BLOCK);

export class Rows {
  constructor(store, onrows) {
    this.store = store;
    this.on = onrows;
    this.blocks = new Map(); // number -> {revision, frames}, the oldest first
    this.columns = new Map(); // slot id -> place in a frame
    this.revision = 0;
    this.requesting = false;
    store.addEventListener("frame", () => this.#request());
  }

  /** All rows are out of date from now on; they are shown until the new ones are there. */
  renew(revision) {
    this.revision = revision;
    this.#request();
  }

  /** The cells of a frame, null if they are not here. */
  frame(index) {
    return this.blocks.get(blockOf(index))?.frames.get(index) ?? null;
  }

  cell(index, slot) {
    const column = this.columns.get(slotId(slot));
    return column === undefined ? null : (this.frame(index)?.[column] ?? null);
  }

  /** Whether the rows of a frame are here and up to date. */
  isCurrent(index) {
    return this.blocks.get(blockOf(index))?.revision === this.revision;
  }

  // the block that is shown, then the one beside it
  #next() {
    const { frame, bounds } = this.store;
    const at = blockOf(frame);
    const near = [at, frame % BLOCK >= BLOCK / 2 ? at + 1 : at - 1];
    const exists = (block) => block >= blockOf(bounds.first) && block <= blockOf(bounds.last);
    return near.find((block) => exists(block) && this.blocks.get(block)?.revision !== this.revision);
  }

  async #request() {
    clearTimeout(this.timer);
    const block = this.#next();
    if (this.requesting || block === undefined || this.store.ended) return;
    this.requesting = true;
    const revision = this.revision;
    const { first, last } = this.store.bounds;
    let wait = 0;
    try {
      const got = await api.rows(Math.max(block * BLOCK, first), Math.min((block + 1) * BLOCK - 1, last));
      this.columns = new Map(got.parts.map(([target, part], column) => [slotId({ target, part }), column]));
      this.blocks.delete(block);
      this.blocks.set(block, { revision, frames: new Map(got.frames.map((cells, i) => [got.first + i, cells])) });
      if (this.blocks.size > MOST) this.blocks.delete(this.blocks.keys().next().value);
      this.on();
    } catch {
      wait = RETRY; // the page itself says that there is no answer
    }
    this.requesting = false;
    this.timer = setTimeout(() => this.#request(), wait);
  }
}
