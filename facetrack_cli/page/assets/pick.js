// Choosing a start: what the cascades propose, the part that comes next, and marks that are of another frame.

import * as api from "./api.js";
import { $, make, spoken, write } from "./dom.js";
import { colour, edges, proposed } from "./draw.js";
import { BOX } from "./store.js";

const REST = 400; // ms that a frame is shown before anybody looks for faces in it
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
    this.known = new Map(); // frame -> answer
    this.asked = null;
    this.looked = null; // the proposal whose button is pointed at, or has the focus
    stage.layers.unshift(proposed(store, () => this.looked));
    store.addEventListener("frame", () => this.#rest());
    for (const name of ["frame", "draft"]) store.addEventListener(name, () => this.update());
    $("begin-here").addEventListener("click", () => this.beginHere());
    $("go-back").addEventListener("click", () => this.goBack());
    TOUCH.addEventListener("change", () => this.update());
    this.#rest();
    this.update();
  }

  /** Whether marks may be changed in the frame that is shown; `loud` tells the user why not. */
  may(loud) {
    const { store } = this;
    if (store.ended) return false;
    if (!store.isHere()) {
      if (loud) {
        this.say(`The start is in frame ${store.draft.frame}. Begin here instead (B), or go back to it (G).`, "warning");
        $("elsewhere").classList.remove("flash");
        void $("elsewhere").offsetWidth; // so that the animation begins anew
        $("elsewhere").classList.add("flash");
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

  // --- proposals

  #rest() {
    const { store } = this;
    clearTimeout(this.timer);
    store.proposals = this.known.get(store.frame)?.proposals ?? [];
    this.looked = null;
    this.timer = setTimeout(() => this.#ask(), REST);
  }

  async #ask() {
    const { store } = this;
    const frame = store.frame;
    if (this.asked !== null || this.known.has(frame) || store.ended) return;
    this.asked = frame;
    this.update();
    try {
      this.known.set(frame, await api.proposals(frame));
    } catch (error) {
      if (error instanceof api.Refused) this.known.set(frame, { proposals: [], note: error.message });
      else this.timer = setTimeout(() => this.#ask(), 2000);
    }
    this.asked = null;
    if (store.frame === frame) store.proposals = this.known.get(frame)?.proposals ?? [];
    else this.#rest();
    this.update();
  }

  take(index, as = null) {
    const { store } = this;
    const proposal = store.proposals[index];
    if (!proposal || !this.may(true)) return false;
    store.take(proposal, as);
    const { done, of } = store.progress();
    this.say(`Took ${proposal.label}. ${done === of ? "Look whether all marks are right, then save." : ""}`);
    return true;
  }

  update() {
    this.#hint();
    this.#elsewhere();
    this.#proposals();
    this.stage.draw();
  }

  #proposals() {
    const { store } = this;
    const known = this.known.get(store.frame);
    const blank = store.isEmpty();
    const shown = store.isHere() && !store.ended;
    const list = shown ? store.proposals : [];
    const taken = list.map((proposal) => this.#taken(proposal));
    const shape = JSON.stringify([store.frame, known, this.asked, blank, shown, taken, store.layout]);
    this.#lie();
    if (shape === this.shape) return;
    this.shape = shape;
    $("proposals").hidden = !shown || (!!known && !known.note && taken.every(Boolean));
    write($("proposals-note"), known ? (known.note ?? "") : "Looking for faces …");
    $("proposals-note").hidden = !!known && !known.note;
    $("proposals-list").replaceChildren(...list.flatMap((proposal, index) => this.#offers(proposal, index, blank)));
    const buttons = list.map((proposal, index) => {
      const take = make("button", { type: "button", tabindex: "-1", "data-testid": `take-picture-${index}` }, `Take ${proposal.label}`);
      take.addEventListener("click", () => this.take(index) && this.stage.canvas.focus());
      return take;
    });
    $("takes").replaceChildren(...(blank ? buttons : []));
    this.#lie();
  }

  #offers(proposal, index, blank) {
    const { store } = this;
    if (this.#taken(proposal)) return [];
    const button = (words, testid, as) => {
      const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.backgroundColor = colour(store, as ?? Object.keys(proposal.targets)[0]);
      const hint = index < 9 && !as ? make("kbd", { "aria-hidden": "true" }, String(index + 1)) : null;
      const made = make("button", { type: "button", class: "offer", "data-testid": testid }, swatch, make("span", {}, words), hint);
      made.addEventListener("click", () => this.take(index, as) && this.stage.canvas.focus());
      for (const [name, value] of Object.entries({ pointerenter: proposal, focus: proposal, pointerleave: null, blur: null })) {
        made.addEventListener(name, () => {
          this.looked = value;
          this.stage.draw();
        });
      }
      return made;
    };
    const offers = [button(`${blank ? "Take" : "Take instead:"} ${proposal.label}`, `take-${index}`, null)];
    const names = Object.keys(proposal.targets);
    if (!blank && store.session.free && names.length === 1 && store.draft.targets[names[0]]) {
      const as = [2, 3, 4, 5, 6, 7, 8, 9].map((n) => `${names[0]}_${n}`).find((name) => !store.group(name));
      if (as) offers.push(button(`Add ${proposal.label} as ${as}`, `add-${index}`, as));
    }
    return offers;
  }

  #taken({ targets }) {
    const alike = ([name, { box, points }]) => {
      const given = this.store.draft.targets[name];
      return JSON.stringify([given?.box, given?.points]) === JSON.stringify([box, points]);
    };
    return Object.entries(targets).every(alike);
  }

  // the buttons on the picture keep to their boxes
  #lie() {
    const { store, stage } = this;
    [...$("takes").children].forEach((button, index) => {
      const box = Object.values(store.proposals[index]?.targets ?? {}).find((target) => target.box)?.box;
      button.hidden = !box;
      if (!box) return;
      const { x0, y0, x1, y1 } = edges(stage, box);
      const { width, height } = stage.box;
      button.hidden = x1 < 0 || y1 < 0 || x0 > width || y0 > height;
      const across = Math.min(Math.max((x0 + x1) / 2, button.offsetWidth / 2 + 4), width - button.offsetWidth / 2 - 4);
      // below, else above, else within: clear of the buttons in the corner
      const down = y1 + 48 < height - 54 ? y1 + 8 : y0 > 52 ? y0 - 48 : Math.max(Math.min(y1 - 48, height - 100), 4);
      button.style.transform = `translate(${Math.round(across - button.offsetWidth / 2)}px, ${Math.round(down)}px)`;
    });
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
      write($("hint-text"), done ? "Look whether every mark is right, then save." : "Take a face that was found, or choose a part.");
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


