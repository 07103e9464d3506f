// Images of the frames: at most one request at a time and one that waits, neighbours in advance, a small cache.

import * as api from "./api.js";

const MOST_BYTES = 48e6; // of JPEGs kept
const NEIGHBOURS = [1, -1, 2, -2];

/** Calls `onimage({bitmap, index, reduce})` with the latest wanted image, and with those on the way to it. */
export class Frames {
  constructor(bounds, { onimage, onrefused, onloading }) {
    this.bounds = bounds;
    this.on = { onimage, onrefused, onloading };
    this.cache = new Map(); // "index/reduce" -> Blob, the oldest first
    this.bytes = 0;
    this.wanted = null;
    this.shown = null;
    this.request = null; // {index, reduce, ahead, abort}
    this.resting = false;
  }

  want(index, reduce) {
    if (this.shown?.index === index && this.shown.reduce <= reduce) {
      this.wanted = null;
      this.on.onloading(false);
    } else {
      this.wanted = { index, reduce };
      this.on.onloading(true);
      if (this.request?.ahead) this.request.abort.abort();
    }
    clearTimeout(this.rest);
    this.resting = false;
    // neighbours are requested only while the user rests at a frame
    this.rest = setTimeout(() => {
      this.resting = true;
      this.load();
    }, 150);
    this.load();
  }

  /** Requests what is wanted next; to be called again when the server is back. */
  async load() {
    if (this.request) return;
    const job = this.#next();
    if (!job) return;
    this.request = { ...job, abort: new AbortController() };
    let more = true;
    try {
      const blob = this.#cached(job) ?? (await api.frameImage(job.index, job.reduce, this.request.abort.signal));
      this.#keep(job, blob);
      if (!job.ahead) await this.#show(job, blob);
    } catch (error) {
      if (error instanceof api.Refused && !job.ahead) {
        if (this.wanted?.index === job.index) this.wanted = null;
        this.on.onloading(false);
        this.on.onrefused(job.index, error);
      }
      more = !(error instanceof api.Unreachable) && !(job.ahead && error instanceof api.Refused);
    }
    this.request = null;
    if (more) this.load();
  }

  #next() {
    if (this.wanted) return { ...this.wanted, ahead: false };
    if (!this.resting || !this.shown) return null;
    const { index, reduce } = this.shown;
    const near = NEIGHBOURS.map((step) => ({ index: index + step, reduce, ahead: true }));
    const { first, last } = this.bounds;
    return near.find((job) => job.index >= first && job.index <= last && !this.cache.has(key(job))) ?? null;
  }

  async #show({ index, reduce }, blob) {
    const bitmap = await createImageBitmap(blob);
    const { wanted } = this;
    // a coarse image, or another frame on the way, is shown only if nothing better is there
    const better = wanted && (wanted.index !== index || wanted.reduce >= reduce);
    if (!better && !(wanted && this.shown?.index !== index)) return bitmap.close?.();
    this.shown?.bitmap.close?.();
    this.shown = { bitmap, index, reduce };
    if (better && wanted.index === index) {
      this.wanted = null;
      this.on.onloading(false);
    }
    this.on.onimage(this.shown);
  }

  #cached(job) {
    const found = this.cache.get(key(job));
    if (found) {
      this.cache.delete(key(job));
      this.cache.set(key(job), found);
    }
    return found;
  }

  #keep(job, blob) {
    if (this.cache.has(key(job))) return;
    this.cache.set(key(job), blob);
    this.bytes += blob.size;
    for (const [oldest, { size }] of this.cache) {
      if (this.bytes <= MOST_BYTES || this.cache.size === 1) break;
      this.cache.delete(oldest);
      this.bytes -= size;
    }
  }
}

const key = ({ index, reduce }) => `${index}/${reduce}`;
