// The jobs of a correction: track from it, remove one, undo the last step.

import * as api from "./api.js";
import { $, capitalized, readable, setText } from "./dom.js";
import { showProblem } from "./save.js";

const INTERVAL = 250; // ms between two requests for the state of a job

const key = ({ frame, target }) => `${frame}/${target}`;
const named = ({ frame, target }) => `${readable(target)} in frame ${frame}`;
const listed = (all) => (all.length > 3 ? `${all.length} targets or frames` : all.map(named).join(", "));

/** The difference between two lists of corrections, in words; empty if there is none. */
export function changes(before, after) {
  const find = (list, one) => list.find((other) => key(other) === key(one));
  const removed = before.filter((one) => !find(after, one));
  const added = after.filter((one) => !find(before, one));
  const other = after.filter((one) => find(before, one) && JSON.stringify(find(before, one)) !== JSON.stringify(one));
  return [
    removed.length && `${listed(removed)} is not corrected any more`,
    added.length && `${listed(added)} is corrected again`,
    other.length && `${listed(other)} is corrected as before`,
  ]
    .filter(Boolean)
    .join("; ");
}

/** What Save does to the rows that are shown, if it is more than writing them. */
export const again = ({ session }) =>
  session.again ? " Save tracks the whole clip again, and its rows may differ a little from these." : "";

export class Jobs {
  /** `corrections()` gives those that there are; `refreshed()` waits for the overview, and gives those of now. */
  constructor(store, sync, { say, corrections, refreshed }) {
    Object.assign(this, { store, sync, say, corrections, refreshed });
    this.running = false; // a job of this window
    this.job = null; // the server's, of any window
    this.seen = false; // whether the server began the job of this window
    this.span = null; // [first, last] frame that this window had tracked
  }

  update({ job }) {
    this.job = job;
    this.store.busy = this.running || !!job;
    $("job").hidden = !this.store.busy;
    if (!this.store.busy) return;
    const bar = $("job-bar");
    const total = this.span ? this.span[1] - this.span[0] + 1 : job?.total;
    if (job && total) {
      bar.max = total;
      bar.value = Math.min(job.done, total);
    } else bar.removeAttribute("value");
    if (job) this.seen = true;
    setText(
      $("job-text"),
      job ? this.#describe(job) : this.seen ? "Reading the new track …" : "Waiting for facetrack …",
    );
  }

  /** The frames that were tracked again so far, [first, last], if that is known. */
  get reached() {
    if (!this.span || !this.job) return null;
    const [first, last] = this.span;
    return [first, Math.min(first + this.job.done, last)];
  }

  #describe({ what, done, total }) {
    const title = capitalized(readable(what));
    if (this.reached) return `${title}: frame ${this.reached[1]} of ${this.span[1]}`;
    return total ? `${title}: ${done} of ${total} frames` : `${title} …`;
  }

  async track() {
    const { store } = this;
    if (store.ended || store.beforeGesture) return;
    if (store.isEmpty()) return this.say("Nothing was moved. Drag what is wrong, or mark it as absent (X).");
    const { frame, targets } = store.draft;
    const names = Object.keys(targets).map(readable).join(", ");
    store.deselect();
    this.say(`Tracking from frame ${frame}: ${names}.`);
    const learn = $("learn-box").checked ? null : false;
    $("learn-box").checked = true; // the choice is for one correction
    const body = () => ({ base: this.sync.revision, learn });
    const done = await this.#run("track", body, [frame, this.#end(frame, targets)]);
    if (done) this.say(`Tracked from frame ${frame}: ${names}.${again(store)}`);
  }

  // the last frame that is tracked again: each target is tracked up to its next correction
  #end(frame, targets) {
    const ends = Object.keys(targets).map((name) => {
      const later = this.corrections().filter((one) => one.target === name && one.frame > frame);
      return Math.min(this.store.bounds.last, ...later.map((one) => one.frame - 1));
    });
    return Math.max(...ends);
  }

  async remove({ frame, target }) {
    if (await this.#run("remove", () => ({ frame, target }))) {
      this.say(`The correction of ${named({ frame, target })} is removed, and the frames after it are tracked again.`);
    }
  }

  /** The hands change their names from a frame on. */
  async exchange(frame) {
    const { store } = this;
    if (store.ended || store.beforeGesture) return;
    if (!store.isEmpty()) return this.say("Track what was moved first, or discard it.", "warning");
    if (await this.#run("exchange", () => ({ frame }), [frame, store.bounds.last])) {
      this.say(`The hands are exchanged from frame ${frame} on.`);
    }
  }

  /** A part lies right in a frame, or in all frames around it in which it is called lost. */
  async confirm({ target, part }, frame, stretch, name) {
    if (await this.#run("confirm", () => ({ frame, target, part, stretch }), [frame, frame])) {
      this.say(`${capitalized(name)} lies right ${stretch ? "in all frames around" : "in frame"} ${frame}.`);
    }
  }

  async undo(before) {
    if (!(await this.#run("undo", () => ({})))) return;
    this.say(`Undone: ${changes(before, await this.refreshed()) || "the last step"}.`);
  }

  // whether it was done; if not, the user was told why
  async #run(path, body, span = null) {
    const { store, sync } = this;
    if (store.busy || store.ended) {
      this.say("Wait until the tracking has finished.", "warning");
      return false;
    }
    Object.assign(this, { running: true, span, seen: false });
    showProblem("");
    this.update({ job: null });
    store.emit("draft");
    let problem = null;
    try {
      await sync.flush();
      await api.post(path, body());
      const state = await this.#finished();
      problem = state?.message ?? null;
    } catch (error) {
      if (error instanceof api.Unreachable) problem = "Not tracked: facetrack does not answer.";
      else if (error instanceof api.Refused) {
        problem = error.message;
        sync.poll();
      } else throw error;
    } finally {
      if (!problem) await this.refreshed();
      Object.assign(this, { running: false, span: null });
      this.update({ job: sync.state.job });
    }
    store.emit("draft");
    if (problem) {
      this.say("");
      showProblem(problem);
    }
    return !problem;
  }

  // the first state without a job
  async #finished() {
    while (!this.store.ended) {
      const state = await this.sync.pollAgain();
      if (state && !state.job) return state;
      await new Promise((resolve) => setTimeout(resolve, INTERVAL));
    }
    return null;
  }
}
