// Keeps the draft here and at the server alike: sends ours, looks for another window's, tells if nobody answers.

import * as api from "./api.js";

const REST = 250; // ms after the last change
const POLL = 1000;
const POLL_JOB = 300;

/** Calls onstate(state), onothers(lost), ongone(), onback(), onrefused(error). */
export class Sync {
  constructor(store, state, on) {
    this.store = store;
    this.on = on;
    this.revision = state.revision;
    this.state = state;
    this.dirty = false;
    this.running = null;
    this.gone = false;
    store.addEventListener("commit", () => {
      this.dirty = true;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.flush().catch(() => {}), REST);
    });
    document.addEventListener("visibilitychange", () => document.hidden || this.poll());
    this.#again();
  }

  /** Sends what is not sent yet; afterwards the server has our draft, or an error says why not. */
  flush() {
    clearTimeout(this.timer);
    this.running ??= this.#send().finally(() => {
      this.running = null;
    });
    return this.running;
  }

  async #send() {
    while (this.dirty && !this.store.ended) {
      this.dirty = false;
      try {
        const { revision } = await api.putDraft(this.revision, this.store.draft);
        this.revision = revision;
        this.#answers();
      } catch (error) {
        if (error instanceof api.Refused && error.status === 409 && error.body?.draft) {
          this.#take(error.body, true);
          continue;
        }
        this.dirty = true;
        if (error instanceof api.Gone) this.#lost();
        else this.on.onrefused(error);
        throw error;
      }
    }
  }

  /** The server's state, null if nobody answers. */
  poll() {
    clearTimeout(this.next);
    if (this.store.ended) return Promise.resolve(null);
    this.polling ??= this.#poll().finally(() => {
      this.polling = null;
      this.#again();
    });
    return this.polling;
  }

  /** As `poll`, but asked for from now on. */
  async fresh() {
    await this.polling;
    return this.poll();
  }

  async #poll() {
    try {
      const state = await api.state();
      this.#answers();
      if (state.revision > this.revision && !this.dirty && !this.running && !this.store.live) this.#take(state, false);
      this.state = state;
      this.on.onstate(state);
      if (this.dirty && !this.running && !this.store.live) this.flush().catch(() => {});
      return state;
    } catch (error) {
      this.#lost(); // also if it refuses: another server is at this address now
      if (!(error instanceof api.Gone || error instanceof api.Refused)) throw error;
      return null;
    }
  }

  #again() {
    clearTimeout(this.next);
    if (!this.store.ended) this.next = setTimeout(() => this.poll(), this.state.job ? POLL_JOB : POLL);
  }

  #take(state, lost) {
    this.revision = state.revision;
    this.state = state;
    if (JSON.stringify(state.draft) === JSON.stringify(this.store.draft)) return;
    this.store.adopt(state.draft);
    this.on.onothers(lost);
    this.on.onstate(state);
  }

  #answers() {
    if (!this.gone) return;
    this.gone = false;
    this.on.onback();
  }

  #lost() {
    if (this.gone || this.store.ended) return;
    this.gone = true;
    this.on.ongone();
  }
}
