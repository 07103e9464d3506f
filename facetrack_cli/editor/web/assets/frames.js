// Pictures of the clip: at most one request under way and one wanted, neighbours fetched ahead, a small cache.

import * as api from "./api.js";

const MOST_BYTES = 48e6; // of JPEGs kept
const AHEAD = [1, -1, 2, -2];

/** Calls `onpicture({bitmap, index, reduce})` with the latest wanted, and with those on the way to it as they come. */
export class Frames {
  constructor(bounds, { onpicture, onrefused, onwait }) {
    this.bounds = bounds;
    this.on = { onpicture, onrefused, onwait };
    this.cache = new Map(); // "index/reduce" -> Blob, the oldest first
    this.bytes = 0;
    this.wanted = null;
    this.shown = null;
    this.flight = null; // {index, reduce, ahead, stop}
    this.resting = false;
  }

  want(index, reduce) {
    if (this.shown?.index === index && this.shown.reduce <= reduce) {
      this.wanted = null;
      this.on.onwait(false);
    } else {
      this.wanted = { index, reduce };
      this.on.onwait(true);
      if (this.flight?.ahead) this.flight.stop.abort();
    }
    clearTimeout(this.rest);
    this.resting = false;
    // ahead only of somebody who goes through slowly or looks
    this.rest = setTimeout(() => {
      this.resting = true;
      this.#pump();
    }, 150);
    this.#pump();
  }

  retry() {
    this.#pump();
  }

  async #pump() {
    if (this.flight) return;
    const job = this.#next();
    if (!job) return;
    this.flight = { ...job, stop: new AbortController() };
    let onward = true;
    try {
      const blob = this.#cached(job) ?? (await api.picture(job.index, job.reduce, this.flight.stop.signal));
      this.#keep(job, blob);
      if (!job.ahead) await this.#show(job, blob);
    } catch (error) {
      if (error instanceof api.Refused && !job.ahead) {
        if (this.wanted?.index === job.index) this.wanted = null;
        this.on.onwait(false);
        this.on.onrefused(job.index, error);
      }
      // without a server, wait until there is one again: `retry`
      onward = !(error instanceof api.Gone) && !(job.ahead && error instanceof api.Refused);
    }
    this.flight = null;
    if (onward) this.#pump();
  }

  #next() {
    if (this.wanted) return { ...this.wanted, ahead: false };
    if (!this.resting || !this.shown) return null;
    const { index, reduce } = this.shown;
    const near = AHEAD.map((step) => ({ index: index + step, reduce, ahead: true }));
    const { first, last } = this.bounds;
    return near.find((job) => job.index >= first && job.index <= last && !this.cache.has(key(job))) ?? null;
  }

  async #show(job, blob) {
    const bitmap = await createImageBitmap(blob);
    const { wanted } = this;
    if (wanted && (wanted.index !== job.index || wanted.reduce >= job.reduce)) {
      this.shown?.bitmap.close?.();
      this.shown = { bitmap, index: job.index, reduce: job.reduce };
      if (wanted.index === job.index) {
        this.wanted = null;
        this.on.onwait(false);
      }
      this.on.onpicture(this.shown);
    } else if (wanted && this.shown?.index !== job.index) {
      this.shown?.bitmap.close?.();
      this.shown = { bitmap, index: job.index, reduce: job.reduce }; // coarse first, then as fine as wanted
      this.on.onpicture(this.shown);
    } else bitmap.close?.();
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
