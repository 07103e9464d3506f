// Keeps the draft of this window and that of the server the same, and notices when the server does not answer.

import * as api from "./api.js";

const REST = 250; // ms after the last change
const POLL = 1000;
const POLL_JOB = 300;

/** Calls onstate(state), onother(lost), onoffline(), ononline(), onrefused(error). */
export class Sync {
  constructor(store, state, on) {
    this.store = store;
    this.on = on;
    this.revision = state.revision;
    this.state = state;
    this.dirty = false;
    this.sending = null;
    this.offline = false;
    store.addEventListener("commit", () => {
      this.dirty = true;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.flush().catch(() => {}), REST);
    });
    document.addEventListener("visibilitychange", () => document.hidden || this.poll());
    this.#schedule();
  }

  /** Sends what is not sent yet; afterwards the server has this draft, or the error says why not. */
  flush() {
    clearTimeout(this.timer);
    this.sending ??= this.#send().finally(() => {
      this.sending = null;
    });
    return this.sending;
  }

  async #send() {
    while (this.dirty && !this.store.ended) {
      this.dirty = false;
      try {
        const { revision } = await api.putDraft(this.revision, this.store.draft);
        this.revision = revision;
        this.#setOffline(false);
      } catch (error) {
        if (error instanceof api.Refused && error.status === 409 && error.body?.draft) {
          this.#adopt(error.body, true);
          continue;
        }
        this.dirty = true;
        if (error instanceof api.Unreachable) this.#setOffline(true);
        else this.on.onrefused(error);
        throw error;
      }
    }
  }

  /** The server's state, null without an answer. */
  poll() {
    clearTimeout(this.next);
    if (this.store.ended) return Promise.resolve(null);
    this.polling ??= this.#poll().finally(() => {
      this.polling = null;
      this.#schedule();
    });
    return this.polling;
  }

  /** As `poll`, but of a request that begins now. */
  async pollAgain() {
    await this.polling;
    return this.poll();
  }

  async #poll() {
    try {
      const state = await api.state();
      this.#setOffline(false);
      const free = () => !this.sending && !this.store.beforeGesture;
      if (state.revision > this.revision && !this.dirty && free()) this.#adopt(state, false);
      this.state = state;
      this.on.onstate(state);
      if (this.dirty && free()) this.flush().catch(() => {});
      return state;
    } catch (error) {
      this.#setOffline(true); // also if it refuses: another server has this address now
      if (!(error instanceof api.Unreachable || error instanceof api.Refused)) throw error;
      return null;
    }
  }

  #schedule() {
    clearTimeout(this.next);
    if (!this.store.ended) this.next = setTimeout(() => this.poll(), this.state.job ? POLL_JOB : POLL);
  }

  // takes the draft of another window; `lost`: a change of this window was too late
  #adopt(state, lost) {
    this.revision = state.revision;
    this.state = state;
    if (JSON.stringify(state.draft) === JSON.stringify(this.store.draft)) return;
    this.store.adopt(state.draft);
    this.on.onother(lost);
    this.on.onstate(state);
  }

  #setOffline(offline) {
    if (offline === this.offline || (offline && this.store.ended)) return;
    this.offline = offline;
    if (offline) this.on.onoffline();
    else this.on.ononline();
  }
}
