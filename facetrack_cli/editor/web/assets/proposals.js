// What the cascades propose for the frame that is shown, to be taken as it is.

import * as api from "./api.js";
import { $, make, write } from "./dom.js";
import { colour, edges, proposed } from "./draw.js";

const REST = 400; // ms that a frame is shown before anybody looks for faces in it

/** `may(loud)` says whether marks may be changed, `wanted()` whether anybody wants to be proposed anything. */
export class Proposals {
  constructor(store, stage, { may, ontaken, wanted = () => true }) {
    Object.assign(this, { store, stage, may, ontaken, wanted });
    this.known = new Map(); // frame -> answer
    this.asked = null;
    this.looked = null; // the proposal whose button is pointed at, or has the focus
    stage.layers.unshift(proposed(store, () => this.looked));
    store.addEventListener("frame", () => this.#rest());
    this.#rest();
  }

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
    if (this.asked !== null || this.known.has(frame) || store.ended || !this.wanted()) return;
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
    this.ontaken(proposal);
    return true;
  }

  update() {
    const { store } = this;
    const known = this.known.get(store.frame);
    const blank = store.isEmpty();
    const shown = store.isHere() && !store.ended && this.wanted();
    const list = shown ? store.proposals : [];
    const taken = list.map((proposal) => this.#taken(proposal));
    const shape = JSON.stringify([store.frame, known, this.asked, blank, shown, taken, store.layout]);
    this.#lie();
    if (shape === this.shape) return;
    this.shape = shape;
    const nothing = taken.every(Boolean) && (store.mode === "fix" || (!!known && !known.note));
    $("proposals").hidden = !shown || nothing;
    write($("proposals-note"), known ? (known.note ?? "") : "Looking for faces …");
    $("proposals-note").hidden = store.mode === "fix" || (!!known && !known.note);
    $("proposals-list").replaceChildren(...list.flatMap((proposal, index) => this.#offers(proposal, index, blank)));
    const buttons = list.map((proposal, index) => {
      const take = make(
        "button",
        { type: "button", tabindex: "-1", "data-testid": `take-picture-${index}` },
        `Take ${proposal.label}`,
      );
      take.addEventListener("click", () => this.take(index) && this.stage.canvas.focus());
      return take;
    });
    $("takes").replaceChildren(...(blank && store.mode === "pick" ? buttons : []));
    this.#lie();
  }

  #offers(proposal, index, blank) {
    const { store } = this;
    if (this.#taken(proposal)) return [];
    const button = (words, testid, as) => {
      const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.backgroundColor = colour(store, as ?? Object.keys(proposal.targets)[0]);
      const hint = index < 9 && !as ? make("kbd", { "aria-hidden": "true" }, String(index + 1)) : null;
      const made = make(
        "button",
        { type: "button", class: "offer", "data-testid": testid },
        swatch,
        make("span", {}, words),
        hint,
      );
      made.addEventListener("click", () => this.take(index, as) && this.stage.canvas.focus());
      for (const [name, value] of Object.entries({
        pointerenter: proposal,
        focus: proposal,
        pointerleave: null,
        blur: null,
      })) {
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
}
