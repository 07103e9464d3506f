// Choosing a start: the part that comes next, and marks of another frame.

import { $, capitalized, readable, say, TOUCH } from "./dom.js";
import { Mode } from "./mode.js";
import { Proposals } from "./proposals.js";
import { BOX } from "./store.js";

// by mouse and by finger
const HOW = {
  open: {
    box: ["Drag across it, from corner to corner.", "Draw across it, from corner to corner."],
    point: ["Click it in the image.", "Tap it; keep the finger down to see it magnified."],
  },
  placed: {
    box: ["Drag it, or its handles; arrow keys nudge.", "Drag it, or its handles."],
    point: ["Drag it, or nudge it with the arrow keys.", "Drag it to correct it."],
  },
};

export class Pick extends Mode {
  over = "Saved";

  constructor(options) {
    super(options);
    this.proposals = new Proposals(this.store, this.stage, (explain) => this.canEdit(explain));
    $("begin-here").addEventListener("click", () => this.beginHere());
    this.update();
  }

  get undoable() {
    return this.store.past.length > 0;
  }

  undo() {
    say(this.store.undo() ? "" : "There is nothing to undo.");
  }

  reasonAgainst() {
    const { store } = this;
    return store.isHere()
      ? null
      : `The start is in frame ${store.draft.frame}. Begin here instead (B), or go back (G).`;
  }

  beginHere() {
    const { store } = this;
    if (store.isHere() || store.ended) return;
    store.beginHere();
    say(`The start is in frame ${store.frame} now; the marks are where they were. Correct them.`);
  }

  /** Writes the start; if something is missing, it is selected. */
  async save() {
    const { store } = this;
    const missing = !(await this.run("save")) && !store.busy && store.nextMissing();
    if (missing) store.select(missing);
  }

  update() {
    const { store } = this;
    const elsewhere = `The marks are of frame ${store.draft.frame}; this is frame ${store.frame}.`;
    this.showHint(hint(store), store.current, elsewhere);
    this.proposals.update();
  }
}

// [title, text]
function hint(store) {
  const { current, layout } = store;
  const { done, of } = store.progress();
  if (store.ended) return ["Saved", "You may close this page."];
  if (!current && !done) return ["Nothing chosen yet", "Take a face that was found, or choose a part."];
  if (!current) return [done === of ? "All parts are placed" : `${of - done} missing`, "Check every mark, then save."];
  const { about, target } = store.group(current.target);
  const box = current.part === BOX;
  const point = `${readable(current.part)}${layout.length > 1 ? ` of ${readable(target)}` : ""}`;
  const what = about?.[current.part];
  const how = HOW[store.value(current) ? "placed" : "open"][box ? "box" : "point"][TOUCH.matches ? 1 : 0];
  return [box ? `Box of ${readable(target)}` : point, `${what ? `${capitalized(what)}. ` : ""}${how}`];
}
