// Images of the frames: at most one request at a time and one that waits, neighbours in advance, a small cache.

import * as api from "./api.js";

const MOST_BYTES = 48e6; // of JPEGs kept
const NEIGHBOURS = [1, -1, 2, -2];

const path = ({ index, reduce }) => `frame?frame=${index}&reduce=${reduce}`;

/** Calls `onimage({bitmap, index, reduce})` with the latest wanted image, and with those on the way to it. */
export class Frames {
  constructor(bounds, on) {
    Object.assign(this, { bounds, on, cache: new Map(), bytes: 0 }); // path -> Blob, the oldest first
    this.wanted = this.shown = null; // {index, reduce}
    this.request = null; // {index, reduce, ahead, abort}
  }

  want(index, reduce) {
    const there = this.shown?.index === index && this.shown.reduce <= reduce;
    this.wanted = there ? null : { index, reduce };
    this.on.onloading(!there);
    if (!there && this.request?.ahead) this.request.abort.abort();
    this.load();
  }

  /** Requests what is wanted next; to be called again when the server is back. */
  async load() {
    const job = this.request ? null : this.#next();
    if (!job) return;
    this.request = { ...job, abort: new AbortController() };
    let more = true;
    try {
      const blob = this.cache.get(path(job)) ?? (await api.image(path(job), this.request.abort.signal));
      this.#keep(path(job), blob);
      if (!job.ahead) await this.#show(job, blob);
    } catch (error) {
      more = error.status ? !job.ahead : !(error instanceof api.Failed);
      if (error.status && !job.ahead) {
        if (this.wanted?.index === job.index) this.wanted = null;
        this.on.onloading(false);
        this.on.onrefused(job.index, error);
      }
    }
    this.request = null;
    if (more) this.load();
  }

  #next() {
    if (this.wanted) return { ...this.wanted, ahead: false };
    if (!this.shown) return null;
    const { index, reduce } = this.shown;
    const near = NEIGHBOURS.map((step) => ({ index: index + step, reduce, ahead: true }));
    const { first, last } = this.bounds;
    return near.find((job) => job.index >= first && job.index <= last && !this.cache.has(path(job))) ?? null;
  }

  async #show({ index, reduce }, blob) {
    const bitmap = await createImageBitmap(blob);
    if (!this.wanted) return bitmap.close(); // the right one is shown again
    this.shown?.bitmap.close();
    this.shown = { bitmap, index, reduce };
    if (this.wanted?.index === index && reduce <= this.wanted.reduce) {
      this.wanted = null;
      this.on.onloading(false);
    }
    this.on.onimage(this.shown);
  }

  #keep(name, blob) {
    if (this.cache.delete(name)) this.bytes -= blob.size; // it becomes the youngest
    this.cache.set(name, blob);
    this.bytes += blob.size;
    for (const [oldest, { size }] of this.cache) {
      if (this.bytes <= MOST_BYTES || this.cache.size === 1) break;
      this.cache.delete(oldest);
      this.bytes -= size;
    }
  }
}
