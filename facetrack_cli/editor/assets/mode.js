// What choosing a start and correcting a run have in common: a hint, a draft of another frame, jobs, the end.

import { $, HOME, make, say, setText, TOUCH } from "./dom.js";
import { colour } from "./draw.js";
import { around, markScale } from "./geometry.js";

const SMALL = 0.6; // marks of less than this share of their size are hard to tell apart

/** Shows a problem above the buttons, or hides it (""). */
export function showProblem(text) {
  $("problem").hidden = !text;
  setText($("problem"), text);
}

/** A subclass has `reasonAgainst`, why marks cannot be changed, `update`, which calls `showHint`, and `over`, a title. */
export class Mode {
  constructor({ store, stage, sync }) {
    Object.assign(this, { store, stage, sync, running: false });
    for (const name of ["frame", "draft"]) store.addEventListener(name, () => this.update());
    TOUCH.addEventListener("change", () => this.update());
    $("go-back").addEventListener("click", () => store.showDraftFrame());
  }

  // --- the view

  /** The place of each target, [left, top, right, bottom] around all of them; null while there is none. */
  get place() {
    const { store } = this;
    return around(store.slots().flatMap((slot) => [store.value(slot) ?? []].filter((place) => place.length)));
  }

  /** Shows the targets; the whole frame if they are shown already, or have no place. */
  showTargets() {
    const { place, stage } = this;
    if (place && stage.fitted) stage.toRegion(place);
    else stage.toFit();
  }

  /** At first, where the points of all targets are too near to be told apart; whether that is known now. */
  showSmall() {
    const { place, stage, store } = this;
    if (!place) return false;
    const points = ({ target }) =>
      store
        .slots()
        .filter((slot) => slot.target === target)
        .map((slot) => store.value(slot))
        .filter((value) => value?.length === 2);
    if (stage.fitted && store.layout.every((one) => markScale(points(one), stage.fit) < SMALL)) {
      stage.toRegion(place);
      say("Zoomed in, since the marks are small. The whole frame: 0, or the button between − and +.");
    }
    return true;
  }

  /** Whether all that belongs to the frame is there. */
  get loaded() {
    return this.stage.image?.index === this.store.frame;
  }

  /** Whether marks may be changed in the frame that is shown; with `explain` the user is told why not. */
  canEdit(explain) {
    const { store } = this;
    if (store.ended) return false;
    const reason = this.reasonAgainst();
    if (explain && reason) {
      say(reason, "warning");
      if (!store.isHere()) $("elsewhere").animate([{ boxShadow: "0 0 0 3px #fae846" }, {}], 800);
    } else if (explain && !this.loaded) say(`Frame ${store.frame} is still loading.`);
    return !reason && this.loaded;
  }

  /** Shows the hint for a slot, or for none; and `elsewhere`, if the draft is of another frame. */
  showHint([title, text], slot, elsewhere) {
    const { store } = this;
    setText($("hint-title"), title);
    setText($("hint-text"), text);
    $("hint").style.setProperty("--hint", slot && !store.ended ? colour(store, slot.target, slot.part) : "var(--accent)");
    $("elsewhere").hidden = store.isHere() || store.ended || store.busy;
    setText($("elsewhere-text"), elsewhere);
    setText($("go-back"), `Back to ${store.draft.frame}`);
    this.stage.draw();
  }

  // --- the server

  /** Has the server do a job; whether it was done. If not, the user is told why. `done` is called before rows are new. */
  async run(path, body = {}, done = async () => {}) {
    const { store, sync } = this;
    if (store.busy || store.ended || store.beforeGesture) {
      if (store.busy) say("Wait until facetrack has finished.", "warning");
      return false;
    }
    this.running = true;
    showProblem("");
    this.setState({ ...sync.state, job: null });
    const problem = await sync.run(path, body);
    if (!problem) await done();
    this.running = false;
    this.setState(sync.state);
    store.emit("draft");
    if (problem) say("");
    showProblem(problem);
    return !problem;
  }

  setState({ job, ended }) {
    const { store } = this;
    store.busy = this.running || !!job;
    $("save").disabled = store.busy || store.ended;
    if (ended && !store.ended) this.#end(ended);
  }

  #end({ messages, next }) {
    const { store } = this;
    store.ended = true;
    store.selected = store.current = null;
    store.emit("draft");
    $("save").disabled = true;
    setText($("saved-title"), this.over);
    $("saved-messages").replaceChildren(...messages.map((line) => make("li", {}, line)));
    $("saved-next").hidden = !next || !!HOME;
    $("saved-quiet").hidden = !!HOME;
    setText($("next-command"), next ?? "");
    $("saved").showModal();
    say(messages.join(". "));
  }
}
