// Keeps the draft of this window on the server, has the server do jobs, and notices when it does not answer.

import * as api from "./api.js";

const REST = 250; // ms after the last change
const POLL = 1000;
const POLL_JOB = 300;

/** Calls onstate(state), onoffline(), ononline(), onrefused(error). */
export class Sync {
  constructor(store, state, on) {
    Object.assign(this, { store, state, on, dirty: false, sending: null, offline: false });
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
        await api.post("draft", { draft: this.store.draft });
        this.#setOffline(false);
      } catch (error) {
        this.dirty = true;
        if (error.status) this.on.onrefused(error);
        else this.#setOffline(true);
        throw error;
      }
    }
  }

  /** Has the server do a job with this draft, and waits for its end: "", or why it was not done. */
  async run(path, body) {
    try {
      await this.flush();
      await api.post(path, body);
    } catch (error) {
      if (error instanceof api.Failed) return error.message;
      throw error;
    }
    await this.polling; // it may be older than the job
    let state = await this.poll();
    while (!this.store.ended && (!state || state.job)) state = await this.poll(POLL_JOB);
    return state?.message ?? "";
  }

  /** The server's state, null without an answer; not before `wait` ms. */
  poll(wait = 0) {
    clearTimeout(this.next);
    this.polling ??= new Promise((resolve) => setTimeout(resolve, wait))
      .then(() => this.#poll())
      .finally(() => {
        this.polling = null;
        this.#schedule();
      });
    return this.polling;
  }

  async #poll() {
    try {
      this.state = await api.state();
      this.#setOffline(false);
      this.on.onstate(this.state);
      if (this.dirty && !this.sending && !this.store.beforeGesture) this.flush().catch(() => {});
      return this.state;
    } catch (error) {
      if (!(error instanceof api.Failed)) throw error;
      this.#setOffline(true); // also if it refuses: another server has this address now
      return null;
    }
  }

  #schedule() {
    clearTimeout(this.next);
    if (!this.store.ended) this.next = setTimeout(() => this.poll(), this.state.job ? POLL_JOB : POLL);
  }

  #setOffline(offline) {
    if (offline === this.offline || (offline && this.store.ended)) return;
    this.offline = offline;
    if (offline) this.on.onoffline();
    else this.on.ononline();
  }
}
