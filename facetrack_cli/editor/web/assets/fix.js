// Putting a run right: what may be moved, what is to be done next, and what the server says of it.

import * as api from "./api.js";
import { $, confirmed, flash, spoken, Tabs, write } from "./dom.js";
import { colour } from "./draw.js";
import { DOUBT, words } from "./fix_list.js";
import { Work } from "./jobs.js";
import { Play } from "./playback.js";
import { Proposals } from "./proposals.js";
import { Doubtful } from "./review.js";
import { Rows } from "./rows.js";
import { BOX } from "./store.js";
import { Timeline } from "./timeline.js";
import { tracks } from "./tracks.js";

const ABOUT = ["moved", "gone", "absent"];

/** The whole of the run in few numbers, for the frame to begin with and the first look. */
export const overview = () => api.get("overview?bins=400");

export class Fix {
  constructor({ store, stage, sync, say, lack, hovered, first }) {
    Object.assign(this, { store, stage, sync, say, lack });
    this.canUndo = false;
    this.shown = true; // the tracks over the picture
    this.revision = null; // of the rows
    this.corrections = first.corrections;
    this.rows = store.rows = new Rows(store, () => store.emit("draft"));
    stage.layers.unshift(tracks(store, this.rows, { shown: () => this.shown, hovered }));
    this.work = new Work(store, sync, {
      say,
      lack,
      known: () => this.corrections,
      renewed: () => this.#renewed(),
    });
    this.play = new Play(store);
    this.doubtful = new Doubtful(store, { say, remove: (one) => this.work.remove(one) });
    this.timeline = new Timeline(store, () => this.#renew());
    this.tabs = new Tabs($("tabs"));
    this.proposals = new Proposals(store, stage, {
      may: (loud) => this.may(loud),
      // what is moved already may be better by a proposal, too
      wanted: () => !store.busy && !this.play.on && any(store, (told) => poor(told) || ABOUT.includes(told.kind)),
      ontaken: ({ label }) => say(`Took ${label}. Look whether it is right, then track from here.`),
    });
    this.#take(first);
    const [worst] = this.doubtful.frames;
    if (store.isEmpty() && worst?.frame === store.frame) this.doubtful.worst();
    for (const name of ["frame", "draft"]) store.addEventListener(name, () => this.update());
    TOUCH.addEventListener("change", () => this.update());
    const press = (id, deed) => $(id).addEventListener("click", deed);
    press("track", () => this.work.track());
    press("track-elsewhere", () => this.work.track());
    press("go-back", () => this.goBack());
    press("throw-away", () => this.throwAway());
    press("discard", () => this.throwAway());
    press("doubt-on", () => this.doubtful.next(1));
    press("doubt-back", () => this.doubtful.next(-1));
  }

  /** Whether marks may be changed in the frame that is shown; `loud` tells the user why not. */
  may(loud) {
    const { store } = this;
    this.play.stop();
    const no = (why, kind) => {
      if (loud) this.say(why, kind);
      return false;
    };
    if (store.ended) return false;
    if (store.busy) return no("Wait for the end of what is being tracked; you may look around meanwhile.", "warning");
    if (!store.isHere()) {
      if (loud) flash($("elsewhere"));
      return no(
        `What was moved in frame ${store.draft.frame} is not tracked yet: track it (T), or throw it away.`,
        "warning",
      );
    }
    if (store.frame === store.bounds.first) {
      return no(
        "The run begins in this frame, which cannot be corrected; facetrack init chooses another start.",
        "warning",
      );
    }
    if (this.stage.picture?.index !== store.frame || !this.rows.fresh(store.frame)) {
      return no(`Frame ${store.frame} is still on its way.`);
    }
    return true;
  }

  // --- deeds

  take(index, as = null) {
    return this.proposals.take(index, as);
  }

  goBack() {
    if (!this.store.isEmpty()) this.store.show(this.store.draft.frame);
  }

  throwAway() {
    const { store } = this;
    if (store.busy || store.ended || store.isEmpty()) return;
    const { frame } = store.draft;
    const here = store.frame;
    store.leave();
    store.throwAway();
    this.say(`What was moved in frame ${frame} is thrown away; undo brings it back.`);
    if (here !== frame) store.show(here);
  }

  /** Says that parts are not there, or that they are: then where, unless the tracker knows. */
  absent(slots, whether) {
    const { store } = this;
    if (!this.may(true)) return;
    const names = slots.length > 1 ? spoken(slots[0].target) : called(store, slots[0]);
    if (whether) {
      store.setAbsent(slots, true);
      return this.say(`From frame ${store.frame} on, ${names} is not there.`);
    }
    if (slots.some((slot) => store.gone(slot))) store.setAbsent(slots, false);
    const nowhere = slots.find((slot) => store.missing(slot));
    if (!nowhere) return this.say(`${names}: there.`);
    const { box, points } = store.group(nowhere.target);
    const place = slots.length > 1 && box !== "no" && points.length ? { target: nowhere.target, part: BOX } : nowhere;
    store.arm(place);
    this.say(place.part === BOX ? `Draw the box of ${spoken(place.target)}.` : `Press where ${names} is.`);
  }

  toggleAbsent(whole) {
    const { store } = this;
    const slot = store.selected ?? store.looked;
    if (!slot) return this.say("Choose a part first: in the picture, or by [ and ].");
    const slots = whole || store.around(slot) ? store.parts(slot.target) : [slot];
    this.absent(slots, !slots.every((one) => store.missing(one)));
  }

  undo() {
    const { store } = this;
    if (store.undo()) this.say("");
    else if (store.busy) this.may(true);
    else if (this.canUndo) this.work.undo(this.corrections);
    else this.say("There is nothing to take back.");
  }

  get undoes() {
    return !this.store.ended && (this.store.past.length > 0 || (this.canUndo && !this.store.busy));
  }

  /** Asks, since what the run's files held before is replaced. */
  async save(save) {
    const { store } = this;
    if (store.ended || save.under) return;
    if (store.busy) return void this.may(true);
    if (!store.isEmpty()) {
      const { frame } = store.draft;
      return this.lack(
        `What was moved in frame ${frame} is not tracked yet: track it (T), or throw it away; then save.`,
      );
    }
    this.play.stop();
    const some = this.canUndo;
    const n = count(this.corrections.length, "correction");
    const yes = some
      ? await confirmed(
          this.corrections.length ? `Save ${n}?` : "Save without corrections?",
          `The trajectory of ${store.session.saves_to} is written anew, its annotated video too, and ` +
            "corrected.init.yaml. What these files hold now is replaced.",
          "Save",
        )
      : await confirmed(
          "There is nothing to save",
          "Nothing was corrected since the page was opened; the run stays as it is.",
          "End facetrack",
        );
    if (!yes) return;
    this.saving = save;
    save.save();
  }

  list() {
    this.tabs.open(0);
  }

  toDoubtful() {
    this.tabs.open(1);
    $("doubtful").querySelector(".goes[tabindex='0']")?.focus();
  }

  toggleShown() {
    this.shown = !this.shown;
    this.say(this.shown ? "The track is shown." : "The track is hidden; V shows it again.");
    this.stage.draw();
  }

  // --- what the server says

  state(now) {
    this.canUndo = now.can_undo;
    this.work.state(now);
    this.timeline.reached = this.work.reached;
    if (now.rows_revision !== this.revision) {
      this.revision = now.rows_revision;
      this.rows.renew(this.revision);
      this.#renew();
    } else if (this.failed) this.#renew();
    this.timeline.draw();
    this.update();
  }

  /** Whether it is told by whoever began the job. */
  hears() {
    return this.work.under;
  }

  /** What another window made of the draft. */
  others(lost) {
    if (this.store.busy) return;
    const words = lost ? "Another window was faster: what it moved is shown now." : "Changed in another window.";
    this.say(words, "warning");
  }

  // the overview anew; of several at once the last
  #renew() {
    const bins = this.timeline?.bins || 400;
    this.failed = false;
    const mine = (this.renewing = api
      .get(`overview?bins=${bins}`)
      .then((found) => this.renewing === mine && this.#take(found))
      .catch((error) => {
        if (!(error instanceof api.Gone || error instanceof api.Refused)) throw error;
        this.failed = true;
      }));
    return mine;
  }

  async #renewed() {
    let last;
    while (last !== this.renewing) await (last = this.renewing);
    return this.corrections;
  }

  #take(found) {
    this.corrections = found.corrections;
    this.doubtful.show(found);
    this.timeline.show(found);
    this.update();
  }

  // --- what is shown

  update() {
    if (!this.work) return;
    this.#hint();
    this.#elsewhere();
    this.#deeds();
    this.proposals.update();
    this.stage.draw();
  }

  #hint() {
    const { store } = this;
    const slot = store.current ?? store.selected ?? store.looked;
    const [title, text] = hint(store, slot);
    write($("hint-title"), title);
    write($("hint-text"), text);
    $("hint").style.setProperty("--hint", slot && !store.ended ? colour(store, slot.target) : "var(--accent)");
  }

  #elsewhere() {
    const { store } = this;
    const away = !store.isHere() && !store.ended && !store.busy;
    $("elsewhere").hidden = !away;
    if (!away) return;
    const { frame } = store.draft;
    write($("elsewhere-text"), `What was moved in frame ${frame} is not tracked yet.`);
    write($("track-elsewhere"), `Track from ${frame}`);
    write($("go-back"), `Back to ${frame}`);
  }

  #deeds() {
    const { store } = this;
    const open = !store.isEmpty() && !store.ended;
    $("track").hidden = !open || store.busy;
    $("discard").hidden = !open || store.busy || !store.isHere();
    const placed = Object.values(store.draft.targets).some(({ box, points }) => box || Object.keys(points).length);
    $("learn").hidden = $("track").hidden || !store.session.learns || !placed;
    write($("track"), store.isHere() ? "Track from here" : `Track from ${store.draft.frame}`);
    $("undo").disabled = !this.undoes;
    $("save").classList.toggle("plain", open || !this.canUndo);
    const all = this.corrections.length;
    if (store.ended || this.saving?.under) return;
    $("save").disabled = store.busy;
    write($("save-label"), !open && this.canUndo && all ? `Save ${count(all, "correction")}` : "Save");
  }
}

// What is to be done next with a run that is put right, in words.

export const TOUCH = window.matchMedia("(pointer: coarse)");
export const count = (n, one, more = `${one}s`) => `${n} ${n === 1 ? one : more}`;

/** How a part is called in a sentence. */
export function called(store, { target, part }) {
  if (part === BOX) return spoken(target);
  return store.layout.length > 1 ? `${spoken(part)} of ${spoken(target)}` : spoken(part);
}

/** Whether what is told of any part of the frame passes a test. */
export function any(store, test) {
  return store.layout.some(({ target }) => store.parts(target).some((slot) => test(store.told(slot))));
}

/** Whether somebody should look at what is told of a part. */
export const poor = ({ kind, confidence }) => kind === "lost" || (confidence ?? 1) < DOUBT;

/** [title, text] for a frame, and for the part that is chosen in it, if any. */
export function hint(store, slot) {
  const frame = `Frame ${store.frame}`;
  if (store.ended) return ["Done", "This page has done its work; you may close it."];
  if (store.frame === store.bounds.first) {
    const next = TOUCH.matches ? "" : " N goes to the next doubtful one.";
    return ["The run begins here", `This frame cannot be corrected.${next}`];
  }
  if (store.busy) return [frame, "You may look around meanwhile."];
  if (store.current) return armed(store, store.current);
  if (slot) return chosen(store, slot);
  if (!store.isEmpty() && store.isHere()) {
    return [`${count(store.moved(), "part")} put right`, "If all is right in this frame now, track from here."];
  }
  const doubt = any(store, poor);
  return [frame, doubt ? "Drag what is wrong, or mark it as not there." : "Nothing is doubtful; drag what is wrong."];
}

function armed(store, slot) {
  if (store.around(slot)) {
    return [`All of ${spoken(slot.target)} anew`, "Draw its box; the points are placed in it by the picture."];
  }
  const press = TOUCH.matches ? "Tap where it is" : "Click where it is";
  const how = slot.part === BOX ? "Draw its box, from corner to corner" : press;
  const more = TOUCH.matches ? "" : "; Enter puts it in the middle";
  return [called(store, slot), store.value(slot) ? `${how}, or drag it.` : `${how}${more}.`];
}

function chosen(store, slot) {
  const told = words(store.told(slot));
  const how = TOUCH.matches ? "Drag it to its place." : "Drag it, or nudge it by the arrow keys. X: not there.";
  if (store.missing(slot)) {
    const again = TOUCH.matches ? "There again, if it is." : "X, if it is there again.";
    return [called(store, slot), `Absent from here on. ${again}`];
  }
  if (!told) return [called(store, slot), how];
  const sure = told.endsWith("%") ? " sure" : "";
  const said = told.replace("lost ", "lost, ");
  return [called(store, slot), `${said[0].toUpperCase()}${said.slice(1)}${sure}. ${how}`];
}
