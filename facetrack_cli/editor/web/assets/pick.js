// Choosing a start: the part that comes next, and marks that are of another frame.

import { $, flash, spoken, write } from "./dom.js";
import { colour } from "./draw.js";
import { Proposals } from "./proposals.js";
import { BOX } from "./store.js";

const TOUCH = window.matchMedia("(pointer: coarse)");
const HOW = {
  open: {
    box: ["Drag across it, from corner to corner.", "Draw across it, from corner to corner."],
    point: ["Click it in the picture.", "Tap it; keep the finger down to look closely."],
  },
  placed: {
    box: ["Drag it, or its handles; arrow keys nudge.", "Drag it, or its handles."],
    point: ["Drag it, or nudge it by the arrow keys.", "Drag it to put it right."],
  },
};

export class Pick {
  constructor({ store, stage, say }) {
    Object.assign(this, { store, stage, say });
    this.proposals = new Proposals(store, stage, {
      may: (loud) => this.may(loud),
      ontaken: ({ label }) => {
        const { done, of } = store.progress();
        say(`Took ${label}. ${done === of ? "Look whether all marks are right, then save." : ""}`);
      },
    });
    for (const name of ["frame", "draft"]) store.addEventListener(name, () => this.update());
    $("begin-here").addEventListener("click", () => this.beginHere());
    $("go-back").addEventListener("click", () => this.goBack());
    TOUCH.addEventListener("change", () => this.update());
    this.update();
  }

  /** Whether marks may be changed in the frame that is shown; `loud` tells the user why not. */
  may(loud) {
    const { store } = this;
    if (store.ended) return false;
    if (!store.isHere()) {
      if (loud) {
        this.say(
          `The start is in frame ${store.draft.frame}. Begin here instead (B), or go back to it (G).`,
          "warning",
        );
        flash($("elsewhere"));
      }
      return false;
    }
    if (this.stage.picture?.index !== store.frame) {
      if (loud) this.say(`Frame ${store.frame} is still on its way.`);
      return false;
    }
    return true;
  }

  beginHere() {
    const { store } = this;
    if (store.isHere() || store.ended) return;
    store.beginHere();
    this.say(`The start is in frame ${store.frame} now, with all marks where they were: put them right.`);
  }

  goBack() {
    if (!this.store.isEmpty()) this.store.show(this.store.draft.frame);
  }

  take(index, as = null) {
    return this.proposals.take(index, as);
  }

  update() {
    this.#hint();
    this.#elsewhere();
    this.proposals.update();
    this.stage.draw();
  }

  // --- what comes next

  #hint() {
    const { store } = this;
    const { current } = store;
    const { done, of } = store.progress();
    const title = $("hint-title");
    if (store.ended) {
      write(title, "Saved");
      write($("hint-text"), "This page has done its work; you may close it.");
    } else if (!current) {
      write(title, done ? (done === of ? "All there" : `${of - done} to go`) : "Nothing chosen yet");
      write(
        $("hint-text"),
        done ? "Look whether every mark is right, then save." : "Take a face that was found, or choose a part.",
      );
    } else {
      const { about, target } = store.group(current.target);
      const many = store.layout.length > 1;
      const box = current.part === BOX;
      write(title, box ? `Box of ${spoken(target)}` : `${spoken(current.part)}${many ? ` of ${spoken(target)}` : ""}`);
      const what = about?.[current.part];
      const placed = store.value(current);
      const how = HOW[placed ? "placed" : "open"][box ? "box" : "point"][TOUCH.matches ? 1 : 0];
      write($("hint-text"), `${what ? `${what[0].toUpperCase()}${what.slice(1)}. ` : ""}${how}`);
    }
    $("hint").style.setProperty("--hint", current && !store.ended ? colour(store, current.target) : "var(--accent)");
  }

  #elsewhere() {
    const { store } = this;
    const away = !store.isHere() && !store.ended;
    $("elsewhere").hidden = !away;
    if (!away) return;
    write($("elsewhere-text"), `These marks are of frame ${store.draft.frame}; you look at frame ${store.frame}.`);
    write($("go-back"), `Back to ${store.draft.frame}`);
  }
}
