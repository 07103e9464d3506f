// What choosing a start and correcting a run have in common: proposals, a hint, and a draft of another frame.

import { $, flash, setText, TOUCH } from "./dom.js";
import { colour } from "./draw.js";
import { Proposals } from "./proposals.js";

/** A subclass has `reasonAgainst`, why marks cannot be changed, and `update`, which calls `showHint`. */
export class Mode {
  constructor({ store, stage, say }, proposals) {
    Object.assign(this, { store, stage, say });
    this.proposals = new Proposals(store, stage, { canEdit: (explain) => this.canEdit(explain), ...proposals });
    for (const name of ["frame", "draft"]) store.addEventListener(name, () => this.update());
    TOUCH.addEventListener("change", () => this.update());
    $("go-back").addEventListener("click", () => store.showDraftFrame());
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
      this.say(reason, "warning");
      if (!store.isHere()) flash($("elsewhere"));
    } else if (explain && !this.loaded) this.say(`Frame ${store.frame} is still loading.`);
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
    this.proposals.update();
    this.stage.draw();
  }
}
