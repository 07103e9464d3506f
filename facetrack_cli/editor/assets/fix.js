// Correcting a run: what may be moved, what comes next, jobs, and the server's state.

import * as api from "./api.js";
import { $, capitalized, plural, readable, say, setText, Tabs, TOUCH } from "./dom.js";
import { describe } from "./fix_list.js";
import { isUncertain } from "./fix_store.js";
import { Mode, showProblem } from "./mode.js";
import { Play } from "./playback.js";
import { Review } from "./review.js";
import { Rows } from "./rows.js";
import { BOX } from "./store.js";
import { Timeline } from "./timeline.js";
import { trackLayer } from "./tracks.js";

const BINS = 400; // of the first overview, until the width of the timeline is known

export const firstOverview = () => api.overview(BINS);

export class Fix extends Mode {
  over = "Done";

  constructor({ store, stage, sync, hovered, overview }) {
    super({ store, stage, sync });
    this.canUndo = this.unsaved = false;
    this.shown = true; // the tracks over the image
    this.revision = null; // of the rows
    this.corrections = overview.corrections;
    this.rows = store.rows = new Rows(store, () => store.emit("draft"));
    stage.layers.unshift(trackLayer(store, this.rows, { shown: () => this.shown, hovered }));
    this.play = new Play(store);
    this.review = new Review(store, (one) => this.remove(one));
    this.timeline = new Timeline(store, () => this.#refresh());
    this.tabs = new Tabs($("tabs"));
    this.#show(overview);
    store.addEventListener("frame", () => this.#follow());
    const [worst] = this.review.frames;
    if (store.isEmpty() && worst?.frame === store.frame) this.review.worst();
    const press = (id, action) => $(id).addEventListener("click", action);
    press("track", () => this.track());
    press("track-elsewhere", () => this.track());
    press("discard-elsewhere", () => this.discard());
    press("discard", () => this.discard());
    press("confirm-row", () => this.confirm(false));
    press("review-next", () => this.review.next(1));
    press("review-previous", () => this.review.next(-1));
    press("done", () => this.done());
  }

  get loaded() {
    return super.loaded && this.rows.isCurrent(this.store.frame);
  }

  canEdit(explain) {
    this.play.stop();
    return super.canEdit(explain);
  }

  reasonAgainst() {
    const { store } = this;
    if (store.busy) return "Wait until the tracking has finished; you may look at other frames.";
    if (!store.isHere())
      return `What was moved in frame ${store.draft.frame} is not tracked yet: track it (T), or discard it.`;
    if (store.frame > store.bounds.first) return null;
    return "The first frame of the run cannot be corrected; facetrack init chooses another start.";
  }

  // --- actions

  discard() {
    const { store } = this;
    if (store.busy || store.ended || store.isEmpty()) return;
    const { frame } = store.draft;
    store.deselect();
    store.discard();
    say(`What was moved in frame ${frame} is discarded; undo restores it.`);
  }

  /** Marks parts as absent, or as present; a part that the tracker has no place of is then placed by the user. */
  setAbsent(slots, absent) {
    const { store } = this;
    if (!this.canEdit(true)) return;
    const [{ target }] = slots;
    const names = slots.length > 1 ? readable(target) : partName(store, slots[0]);
    if (absent) {
      store.setAbsent(slots, true);
      return say(`Absent from frame ${store.frame} on: ${names}.`);
    }
    if (slots.some((slot) => store.markedAbsent(slot))) store.setAbsent(slots, false);
    const nowhere = slots.find((slot) => store.isAbsent(slot));
    if (!nowhere) return say(`Present: ${names}.`);
    const { box, points } = store.group(target);
    const slot = slots.length > 1 && box !== "no" && points.length ? { target, part: BOX } : nowhere;
    store.choose(slot);
    say(slot.part === BOX ? `Draw the box of ${readable(target)}.` : `Click the place of ${names}.`);
  }

  toggleAbsent(whole) {
    const { store } = this;
    const slot = store.selected ?? store.highlighted;
    if (!slot) return say("Choose a part first: in the image, or with [ and ].");
    const slots = whole || store.isBoxOfPoints(slot) ? store.parts(slot.target) : [slot];
    this.setAbsent(slots, !slots.every((one) => store.isAbsent(one)));
  }

  async undo() {
    const { store } = this;
    if (store.undo()) say("");
    else if (store.busy) this.canEdit(true);
    else if (!this.canUndo) say("There is nothing to undo.");
    else if (await this.#run("undo")) say(`Undone: ${plural(this.corrections.length, "correction")} now.`);
  }

  get undoable() {
    return this.store.past.length > 0 || (this.canUndo && !this.store.busy);
  }

  // --- jobs

  /** As `run`; afterwards the rows and the overview are those of the corrections of now. */
  #run(path, body, settle = () => {}) {
    return this.run(path, body, () => {
      settle();
      return this.#refreshed();
    });
  }

  /** The draft becomes a correction, and its targets are tracked from it. */
  async track() {
    const { store } = this;
    if (store.isEmpty()) return say("Nothing was moved. Drag what is wrong, or mark it as absent (X).");
    const { frame, targets } = store.draft;
    const names = Object.keys(targets).map(readable).join(", ");
    store.deselect();
    say(`Tracking from frame ${frame}: ${names}.`);
    const learn = $("learn-box").checked ? null : false;
    const again = store.session.again ? " Save tracks all of the clip again; rows may differ a little from these." : "";
    if (!(await this.#run("track", { learn }, () => store.forget()))) return;
    $("learn-box").checked = true; // the choice is for one correction
    say(`Tracked from frame ${frame}: ${names}.${again}`);
  }

  async remove({ frame, target }) {
    if (await this.#run("remove", { frame, target })) {
      say(`The correction of ${readable(target)} in frame ${frame} is removed, and what follows is tracked again.`);
    }
  }

  // whether nothing is moved that is not tracked
  #tracked(what) {
    const { store } = this;
    const text = `What was moved in frame ${store.draft.frame} is not tracked yet: track it (T), or discard it`;
    if (!store.isEmpty()) showProblem(`${text}; then ${what}.`);
    return store.isEmpty() && !store.ended;
  }

  /** The hands change their names from this frame on. */
  async exchange() {
    const { frame } = this.store;
    if (this.#tracked("exchange the hands") && (await this.#run("exchange", { frame }))) {
      say(`The hands are exchanged from frame ${frame} on.`);
    }
  }

  /** The part that is selected, or because of which the frame is shown, lies right; or in the whole stretch around. */
  async confirm(stretch) {
    const { store } = this;
    const slot = store.selected ?? store.highlighted;
    if (!slot || store.isBoxOfPoints(slot)) return say("Choose a part first: in the image, or with [ and ].");
    if (!this.#tracked("confirm") || !this.canEdit(true)) return;
    const { frame } = store;
    if (await this.#run("confirm", { frame, ...slot, stretch })) {
      const where = stretch ? "in all frames around" : "in frame";
      say(`${capitalized(partName(store, slot))} lies right ${where} ${frame}.`);
    }
  }

  /** Asks first, since the files of the run are replaced. */
  async save() {
    const { store } = this;
    if (store.busy || !this.#tracked("save")) return;
    this.play.stop();
    if (!this.unsaved) return say("There is nothing to save: the files of the run are as they are shown.");
    const question = `Save ${plural(this.corrections.length, "correction")} in ${store.session.saves_to}?`;
    const text = "The trajectory, the annotated video and corrected.init.yaml that are there are replaced.";
    if (!confirm(`${question}\n\n${text}`)) return;
    if (await this.#run("save")) say(`Saved. ${this.sync.state.saved.join(". ")}`);
  }

  /** Ends the page. */
  async done() {
    if (!this.#tracked("end")) return;
    const text = "They are kept beside the run, and the page begins with them the next time.";
    if (!this.unsaved || confirm(`End without saving the corrections?\n\n${text}`)) await this.run("done");
  }

  focusReview() {
    this.tabs.open(1);
    $("review").querySelector(".goes[tabindex='0']")?.focus();
  }

  toggleShown() {
    this.shown = !this.shown;
    say(this.shown ? "The track is shown." : "The track is hidden; V shows it again.");
    this.stage.draw();
  }

  // --- the server's state

  setState(now) {
    super.setState(now);
    this.canUndo = now.can_undo;
    this.unsaved = now.unsaved;
    this.#showJob(now.job);
    if (now.rows_revision !== this.revision) {
      this.revision = now.rows_revision;
      this.rows.renew(this.revision);
      this.#refresh();
    } else if (this.failed) this.#refresh();
    this.update();
  }

  #showJob(job) {
    $("job").hidden = !this.store.busy;
    if (job?.total) Object.assign($("job-bar"), { max: job.total, value: job.done });
    else $("job-bar").removeAttribute("value");
    const frames = job?.total ? `: ${job.done} of ${job.total} frames` : " …";
    setText($("job-text"), `${capitalized(readable(job?.what ?? "waiting for facetrack"))}${frames}`);
  }

  // requests the overview again; of several requests at a time, the last one counts
  #refresh() {
    this.failed = false;
    const mine = (this.refreshing = api
      .overview(this.timeline?.bins || BINS)
      .then((found) => this.refreshing === mine && this.#show(found))
      .catch((error) => {
        if (!(error instanceof api.Failed)) throw error;
        this.failed = true;
      }));
  }

  // zoomed in, a single target does not leave the view
  #follow() {
    const { place, stage, store } = this;
    if (!place || store.layout.length > 1) return;
    const [left, top, right, bottom] = place;
    stage.reveal((left + right) / 2, (top + bottom) / 2);
  }

  async #refreshed() {
    let last;
    while (last !== this.refreshing) await (last = this.refreshing);
  }

  #show(overview) {
    this.corrections = overview.corrections;
    this.review.show(overview);
    this.timeline.show(overview);
    this.update();
  }

  // --- what is shown

  update() {
    const { store } = this;
    const slot = store.current ?? store.selected ?? store.highlighted;
    const { frame } = store.draft;
    this.showHint(hint(store, slot), slot, `What was moved in frame ${frame} is not tracked yet.`);
    setText($("track-elsewhere"), `Track from ${frame}`);
    this.#updateButtons();
  }

  #updateButtons() {
    const { store } = this;
    const open = !store.isEmpty() && !store.ended;
    $("track").hidden = !open || store.busy;
    $("discard").hidden = !open || store.busy || !store.isHere();
    const placed = Object.values(store.draft.targets).some(({ box, points }) => box || Object.keys(points).length);
    $("learn").hidden = $("track").hidden || !store.session.learns || !placed;
    setText($("track"), store.isHere() ? "Track from here" : `Track from ${store.draft.frame}`);
    $("undo").disabled = store.ended || !this.undoable;
    const lost = store.selected ?? store.highlighted;
    $("confirm-row").hidden = open || store.busy || store.ended || !lost || !isUncertain(store.report(lost));
    $("done").hidden = open || store.ended;
    $("done").disabled = store.busy;
    $("save").classList.toggle("primary", !open && this.unsaved);
  }
}

// --- texts

/** The name of a slot in a sentence. */
function partName(store, { target, part }) {
  if (part === BOX) return readable(target);
  return store.layout.length > 1 ? `${readable(part)} of ${readable(target)}` : readable(part);
}


// [title, text] for the frame, or for the slot that is chosen in it
function hint(store, slot) {
  const frame = `Frame ${store.frame}`;
  if (store.ended) return ["Done", "You may close this page."];
  if (store.frame === store.bounds.first) {
    const next = TOUCH.matches ? "" : " N goes to the next frame to review.";
    return ["The first frame of the run", `It cannot be corrected.${next}`];
  }
  if (store.busy) return [frame, "You may look at other frames."];
  if (store.current) return [partName(store, store.current), howToPlace(store, store.current)];
  if (slot) return [partName(store, slot), howToCorrect(store, slot)];
  if (!store.isEmpty() && store.isHere()) {
    return [`${plural(store.changed(), "part")} changed`, "If all of this frame is right now, track from here."];
  }
  const uncertain = store.allParts().some((slot) => isUncertain(store.report(slot)));
  return [frame, uncertain ? "Drag what is wrong, or set it absent." : "Nothing is uncertain. Drag what is wrong."];
}

function howToPlace(store, slot) {
  if (store.isBoxOfPoints(slot)) return "Draw its box; all points are placed in it automatically.";
  const click = TOUCH.matches ? "Tap its place" : "Click its place";
  const how = slot.part === BOX ? "Draw its box, from corner to corner" : click;
  const more = TOUCH.matches ? "" : "; Enter places it in the middle";
  return store.value(slot) ? `${how}, or drag it.` : `${how}${more}.`;
}

function howToCorrect(store, slot) {
  if (store.isAbsent(slot)) {
    return `Absent from here on. ${TOUCH.matches ? "Set present" : "X"}, if it is visible again.`;
  }
  const report = describe(store.report(slot));
  const right = isUncertain(store.report(slot)) ? " Y: it lies right." : "";
  const how = TOUCH.matches ? "Drag it to its place." : `Drag it, or nudge it with the arrow keys. X: absent.${right}`;
  return report ? `${capitalized(report)}${report.endsWith("%") ? " confidence" : ""}. ${how}` : how;
}
