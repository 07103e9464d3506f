// Faces that were found in the frame, to be taken as they are.

import * as api from "./api.js";
import { $, button, make, say, setText, swatch } from "./dom.js";
import { colour, proposalLayer } from "./draw.js";

const REST = 400; // ms that a frame is shown before its faces are looked for
const RETRY = 2000; // ms after a request failed

/** `canEdit(explain)` says whether marks may be changed. */
export class Proposals {
  constructor(store, stage, canEdit) {
    Object.assign(this, { store, stage, canEdit });
    this.known = new Map(); // frame -> answer
    this.requested = null; // a frame
    this.previewed = null; // the proposal whose button has the pointer or the focus
    stage.layers.unshift(proposalLayer(store, () => this.previewed));
    store.addEventListener("frame", () => this.#rest());
    this.#rest();
  }

  #rest() {
    const { store } = this;
    clearTimeout(this.timer);
    store.proposals = this.known.get(store.frame)?.proposals ?? [];
    this.previewed = null;
    this.timer = setTimeout(() => this.#request(), REST);
  }

  async #request() {
    const { store } = this;
    const frame = store.frame;
    if (this.requested !== null || this.known.has(frame) || store.ended) return;
    this.requested = frame;
    this.update();
    try {
      this.known.set(frame, await api.proposals(frame));
    } catch (error) {
      if (error.status) this.known.set(frame, { proposals: [], note: error.message });
      else this.timer = setTimeout(() => this.#request(), RETRY);
    }
    this.requested = null;
    if (store.frame === frame) store.proposals = this.known.get(frame)?.proposals ?? [];
    else this.#rest();
    this.update();
    this.stage.draw();
  }

  take(index, as = null) {
    const { store } = this;
    const proposal = store.proposals[index];
    if (!proposal || !this.canEdit(true)) return false;
    store.take(proposal, as);
    const { done, of } = store.progress();
    say(`Took ${proposal.label}.${done === of ? " Check that every mark is right, then save." : ""}`);
    return true;
  }

  update() {
    const { store } = this;
    const known = this.known.get(store.frame);
    const empty = store.isEmpty();
    const shown = store.isHere() && !store.ended;
    const list = shown ? store.proposals : [];
    const taken = list.map((proposal) => this.#isTaken(proposal));
    const shape = JSON.stringify([store.frame, known, this.requested, empty, shown, taken, store.layout]);
    if (shape !== this.shape) {
      this.shape = shape;
      const noNote = !!known && !known.note;
      $("proposals").hidden = !shown || (taken.every(Boolean) && noNote);
      setText($("proposals-note"), known ? (known.note ?? "") : "Looking for faces …");
      $("proposals-note").hidden = noNote;
      $("proposals-list").replaceChildren(...list.flatMap((proposal, index) => this.#offers(proposal, index, empty)));
    }
  }

  #takeAndFocus(index, as = null) {
    if (this.take(index, as)) this.stage.canvas.focus();
  }

  #offers(proposal, index, empty) {
    const { store } = this;
    if (this.#isTaken(proposal)) return [];
    const preview = (shown) => () => {
      this.previewed = shown;
      this.stage.draw();
    };
    const offer = (text, id, as) =>
      button(
        id,
        {
          class: "offer",
          click: () => this.#takeAndFocus(index, as),
          pointerenter: preview(proposal),
          focus: preview(proposal),
          pointerleave: preview(null),
          blur: preview(null),
        },
        swatch(colour(store, as ?? Object.keys(proposal.targets)[0])),
        make("span", {}, text),
        index < 9 && !as ? make("kbd", { "aria-hidden": "true" }, String(index + 1)) : null,
      );
    const offers = [offer(`${empty ? "Take" : "Take instead:"} ${proposal.label}`, `take-${index}`, null)];
    const names = Object.keys(proposal.targets);
    if (!empty && store.session.free && names.length === 1 && store.draft.targets[names[0]]) {
      const as = [2, 3, 4, 5, 6, 7, 8, 9].map((n) => `${names[0]}_${n}`).find((name) => !store.group(name));
      if (as) offers.push(offer(`Add ${proposal.label} as ${as}`, `add-${index}`, as));
    }
    return offers;
  }

  #isTaken({ targets }) {
    return Object.entries(targets).every(([name, { box, points }]) => {
      const given = this.store.draft.targets[name];
      return JSON.stringify([given?.box, given?.points]) === JSON.stringify([box, points]);
    });
  }
}
