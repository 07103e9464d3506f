// What facetrack is asked to do with corrections: track from them, remove one, take the last step back.

import * as api from "./api.js";
import { $, spoken, write } from "./dom.js";

const ASKED = 250; // ms between two looks at a job

const key = ({ frame, target }) => `${frame}/${target}`;
const named = ({ frame, target }) => `${spoken(target)} in frame ${frame}`;
const listed = (all) => (all.length > 3 ? `${all.length} targets or frames` : all.map(named).join(", "));

/** What became of a list of corrections, in words; empty if it is as before. */
export function changes(before, after) {
  const known = (list, one) => list.find((other) => key(other) === key(one));
  const gone = before.filter((one) => !known(after, one));
  const come = after.filter((one) => !known(before, one));
  const other = after.filter((one) => known(before, one) && JSON.stringify(known(before, one)) !== JSON.stringify(one));
  const words = [];
  if (gone.length) words.push(`${listed(gone)} is not corrected any more`);
  if (come.length) words.push(`${listed(come)} is corrected again`);
  if (other.length) words.push(`${listed(other)} is corrected as before`);
  return words.join("; ");
}

export class Work {
  /** `known()` gives the corrections that there are; `renewed()` waits for the overview, and gives those of now. */
  constructor(store, sync, { say, lack, known, renewed }) {
    Object.assign(this, { store, sync, say, lack, known, renewed });
    this.under = false;
    this.job = null;
    this.begun = false; // whether a job of ours was seen
    this.span = null; // [first, last] frame that we asked to be tracked
  }

  state({ job }) {
    this.job = job;
    this.#busy();
    $("job").hidden = !this.store.busy;
    if (!this.store.busy) return;
    const bar = $("job-bar");
    const total = this.span ? this.span[1] - this.span[0] + 1 : job?.total;
    if (job && total) {
      bar.max = total;
      bar.value = Math.min(job.done, total);
    } else bar.removeAttribute("value");
    if (job) this.begun = true;
    write($("job-text"), job ? this.#told(job) : this.begun ? "Reading the new track …" : "Asking facetrack …");
  }

  /** The frames that were tracked anew so far, [first, last], if that is known. */
  get reached() {
    if (!this.span || !this.job) return null;
    const [first, last] = this.span;
    return [first, Math.min(first + this.job.done, last)];
  }

  #told({ what, done, total }) {
    const begun = `${what[0].toUpperCase()}${spoken(what).slice(1)}`;
    if (this.reached) return `${begun}: frame ${this.reached[1]} of ${this.span[1]}`;
    return total ? `${begun}: ${done} of ${total} frames` : `${begun} …`;
  }

  async track() {
    const { store } = this;
    if (store.ended || store.live) return;
    if (store.isEmpty()) return this.say("Nothing was moved: drag what is wrong, or mark it as not there (X).");
    const { frame, targets } = store.draft;
    const names = Object.keys(targets).map(spoken).join(", ");
    store.leave();
    this.say(`Tracking anew from frame ${frame}: ${names}.`);
    const learn = $("learn-box").checked ? null : false;
    $("learn-box").checked = true; // what is said of one correction is not said of the next
    const body = () => ({ base: this.sync.revision, learn });
    const done = await this.#ask("track", body, [frame, this.#end(frame, targets)]);
    if (done) this.say(`Tracked anew from frame ${frame}: ${names}.`);
  }

  // the last frame that is to be tracked anew: each target goes on to its next correction
  #end(frame, targets) {
    const { bounds } = this.store;
    const ends = Object.keys(targets).map((name) => {
      const later = this.known().filter((one) => one.target === name && one.frame > frame);
      return Math.min(bounds.last, ...later.map((one) => one.frame - 1));
    });
    return Math.max(...ends);
  }

  async remove({ frame, target }) {
    if (await this.#ask("remove", () => ({ frame, target }), null)) {
      this.say(`The correction of ${named({ frame, target })} is removed, and what followed from it tracked anew.`);
    }
  }

  async undo(before) {
    if (!(await this.#ask("undo", () => ({}), null))) return;
    this.say(`Taken back: ${changes(before, await this.renewed()) || "the last step"}.`);
  }

  // whether it was done; if not, the user was told why
  async #ask(what, body, span) {
    const { store, sync } = this;
    if (store.busy || store.ended) {
      this.say("Wait for the end of what is being tracked.", "warning");
      return false;
    }
    this.under = true;
    this.span = span;
    this.begun = false;
    this.lack("");
    this.state({ job: null });
    store.emit("draft");
    let failed = null;
    try {
      await sync.flush();
      await api.post(what, body());
      const state = await this.#followed();
      failed = state?.message ?? null;
    } catch (error) {
      if (error instanceof api.Gone) failed = "Not tracked: facetrack does not answer.";
      else if (error instanceof api.Refused) {
        failed = error.message;
        sync.poll();
      } else throw error;
    } finally {
      if (!failed) await this.renewed();
      this.under = false;
      this.span = null;
      this.state({ job: sync.state.job });
    }
    store.emit("draft");
    if (failed) {
      this.say("");
      this.lack(failed);
    }
    return !failed;
  }

  async #followed() {
    while (!this.store.ended) {
      const state = await this.sync.fresh();
      if (state && !state.job) return state;
      await new Promise((done) => setTimeout(done, ASKED));
    }
    return null;
  }

  #busy() {
    this.store.busy = this.under || !!this.job;
  }
}
