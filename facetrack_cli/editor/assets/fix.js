// Correcting a run: what may be moved, what comes next, and the server's state.

import * as api from "./api.js";
import { $, askToConfirm, capitalized, plural, readable, setText, Tabs, TOUCH } from "./dom.js";
import { describe } from "./fix_list.js";
import { isUncertain } from "./fix_store.js";
import { again, Jobs } from "./jobs.js";
import { Mode } from "./mode.js";
import { Play } from "./playback.js";
import { Review } from "./review.js";
import { Rows } from "./rows.js";
import { showProblem } from "./save.js";
import { BOX } from "./store.js";
import { Timeline } from "./timeline.js";
import { trackLayer } from "./tracks.js";

const BINS = 400; // of the first overview, until the width of the timeline is known

export const firstOverview = () => api.overview(BINS);

export class Fix extends Mode {
  constructor({ store, stage, sync, say, hovered, overview }) {
    super(
      { store, stage, say },
      {
        // proposals may improve what is uncertain, and what was moved already
        wanted: () => !store.busy && !this.play.on && anyPart(store, (one) => isUncertain(one) || isChanged(one)),
        ontaken: ({ label }) => say(`Took ${label}. Check it, then track from here.`),
      },
    );
    this.sync = sync;
    this.canUndo = this.unsaved = false;
    this.shown = true; // the tracks over the image
    this.revision = null; // of the rows
    this.corrections = overview.corrections;
    this.rows = store.rows = new Rows(store, () => store.emit("draft"));
    stage.layers.unshift(trackLayer(store, this.rows, { shown: () => this.shown, hovered }));
    this.jobs = new Jobs(store, sync, {
      say,
      corrections: () => this.corrections,
      refreshed: () => this.#refreshed(),
    });
    this.play = new Play(store);
    this.review = new Review(store, { say, remove: (one) => this.jobs.remove(one) });
    this.timeline = new Timeline(store, () => this.#refresh());
    this.tabs = new Tabs($("tabs"));
    this.#show(overview);
    store.addEventListener("frame", () => this.#follow());
    const [worst] = this.review.frames;
    if (store.isEmpty() && worst?.frame === store.frame) this.review.worst();
    const press = (id, action) => $(id).addEventListener("click", action);
    press("track", () => this.jobs.track());
    press("track-elsewhere", () => this.jobs.track());
    press("discard-elsewhere", () => this.discard());
    press("discard", () => this.discard());
    press("confirm-row", () => this.confirm(false));
    press("review-next", () => this.review.next(1));
    press("review-previous", () => this.review.next(-1));
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
    this.say(`What was moved in frame ${frame} is discarded; undo restores it.`);
  }

  /** Marks parts as absent, or as present; a part that the tracker has no place of is then placed by the user. */
  setAbsent(slots, absent) {
    const { store } = this;
    if (!this.canEdit(true)) return;
    const [{ target }] = slots;
    const names = slots.length > 1 ? readable(target) : partName(store, slots[0]);
    if (absent) {
      store.setAbsent(slots, true);
      return this.say(`Absent from frame ${store.frame} on: ${names}.`);
    }
    if (slots.some((slot) => store.markedAbsent(slot))) store.setAbsent(slots, false);
    const nowhere = slots.find((slot) => store.isAbsent(slot));
    if (!nowhere) return this.say(`Present: ${names}.`);
    const { box, points } = store.group(target);
    const slot = slots.length > 1 && box !== "no" && points.length ? { target, part: BOX } : nowhere;
    store.choose(slot);
    this.say(slot.part === BOX ? `Draw the box of ${readable(target)}.` : `Click the place of ${names}.`);
  }

  toggleAbsent(whole) {
    const { store } = this;
    const slot = store.selected ?? store.highlighted;
    if (!slot) return this.say("Choose a part first: in the image, or with [ and ].");
    const slots = whole || store.isBoxOfPoints(slot) ? store.parts(slot.target) : [slot];
    this.setAbsent(slots, !slots.every((one) => store.isAbsent(one)));
  }

  undo() {
    const { store } = this;
    if (store.undo()) this.say("");
    else if (store.busy) this.canEdit(true);
    else if (this.canUndo) this.jobs.undo(this.corrections);
    else this.say("There is nothing to undo.");
  }

  get undoable() {
    return this.store.past.length > 0 || (this.canUndo && !this.store.busy);
  }

  /** The part that is selected, or because of which the frame is shown, lies right; or in the whole stretch around. */
  confirm(stretch) {
    const { store } = this;
    const slot = store.selected ?? store.highlighted;
    if (!slot || store.isBoxOfPoints(slot)) return this.say("Choose a part first: in the image, or with [ and ].");
    if (!store.isEmpty()) return this.say("Track what was moved first, or discard it.", "warning");
    if (this.canEdit(true)) void this.jobs.confirm(slot, store.frame, stretch, partName(store, slot));
  }

  // whether what was moved is tracked, and nothing runs; else it says so
  #settled(what) {
    const { store } = this;
    if (store.busy) this.canEdit(true);
    if (store.ended || store.busy) return false;
    const { frame } = store.draft;
    const text = `What was moved in frame ${frame} is not tracked yet: track it (T), or discard it; then ${what}.`;
    if (!store.isEmpty()) showProblem(text);
    return store.isEmpty();
  }

  /** Asks first, since the files of the run are replaced. */
  async save(save) {
    const { store } = this;
    if (save.running || !this.#settled("save")) return;
    this.play.stop();
    if (!this.unsaved) return this.say("There is nothing to save: the files of the run are as they are shown.");
    const count = this.corrections.length;
    const yes = await askToConfirm(
      count ? `Save ${plural(count, "correction")}?` : "Save without corrections?",
      `In ${store.session.saves_to}, the trajectory, the annotated video and corrected.init.yaml are written. ` +
        `They replace the files that are there now.${again(store)}`,
      "Save",
    );
    if (!yes) return;
    this.saving = save;
    save.save();
  }

  /** Ends the page. */
  async done() {
    if (!this.#settled("end")) return;
    const text = "They are kept beside the run, and the page begins with them the next time.";
    if (this.unsaved && !(await askToConfirm("End without saving?", text, "End"))) return;
    try {
      await api.post("done", {});
    } catch (error) {
      this.say(error.message, "error");
    }
    this.sync.pollAgain();
  }

  focusReview() {
    this.tabs.open(1);
    $("review").querySelector(".goes[tabindex='0']")?.focus();
  }

  toggleShown() {
    this.shown = !this.shown;
    this.say(this.shown ? "The track is shown." : "The track is hidden; V shows it again.");
    this.stage.draw();
  }

  // --- the server's state

  setState(now) {
    this.canUndo = now.can_undo;
    this.unsaved = now.unsaved;
    this.jobs.update(now);
    this.timeline.reached = this.jobs.reached;
    if (now.rows_revision !== this.revision) {
      this.revision = now.rows_revision;
      this.rows.renew(this.revision);
      this.#refresh();
    } else if (this.failed) this.#refresh();
    this.timeline.draw();
    this.update();
  }

  // requests the overview again; of several requests at a time, the last one counts
  #refresh() {
    this.failed = false;
    const mine = (this.refreshing = api
      .overview(this.timeline?.bins || BINS)
      .then((found) => this.refreshing === mine && this.#show(found))
      .catch((error) => {
        if (!(error instanceof api.Unreachable || error instanceof api.Refused)) throw error;
        this.failed = true;
      }));
  }

  /** A job of this window, which reports it by itself. */
  get ownJob() {
    return this.jobs.running;
  }

  onOther(lost) {
    if (this.store.busy) return;
    const text = lost ? "Another window was faster; its change is shown now." : "Changed in another window.";
    this.say(text, "warning");
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
    return this.corrections;
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
    if (store.ended || this.saving?.running) return;
    const count = this.corrections.length;
    $("save").disabled = store.busy;
    setText($("save-label"), !open && this.unsaved && count ? `Save ${plural(count, "correction")}` : "Save");
  }
}

// --- texts

/** The name of a slot in a sentence. */
function partName(store, { target, part }) {
  if (part === BOX) return readable(target);
  return store.layout.length > 1 ? `${readable(part)} of ${readable(target)}` : readable(part);
}

const isChanged = ({ kind }) => ["moved", "marked", "absent"].includes(kind);
const anyPart = (store, test) => store.allParts().some((slot) => test(store.report(slot)));

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
  const uncertain = anyPart(store, isUncertain);
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
