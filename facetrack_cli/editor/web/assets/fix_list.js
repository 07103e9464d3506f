// Every part of the run in the frame that is shown: how sure the tracker is of it, and whether it is there at all.

import { $, make, rove, spoken, write } from "./dom.js";
import { colour } from "./draw.js";
import { BOX, same } from "./store.js";

export const DOUBT = 0.5; // of a confidence, as the server has it
const SIGNS = { moved: "hand", gone: "absent", absent: "absent", lost: "lost", init: "init", tracked: "tracked" };

const id = (slot) => (slot ? `${slot.target}/${slot.part}` : "");

/** How sure the tracker is, and of what, in a few words. */
export function words({ kind, confidence, byHand }) {
  const sure = confidence === null || confidence === undefined ? "" : `${Math.round(confidence * 100)} %`;
  if (kind === "moved") return "put right";
  if (kind === "gone" || kind === "absent") return "absent";
  if (kind === "init") return byHand ? "by hand" : "begins";
  if (kind === "lost") return sure ? `lost ${sure}` : "lost";
  return sure || (kind === "tracked" ? "tracked" : "");
}

/** `choose(slot, byKey)` as of List; `absent(slots, whether)` says that parts are not there, or there again. */
export class FixList {
  constructor(store, { choose, absent }) {
    Object.assign(this, { store, choose, absent });
    this.root = $("parts");
    this.rows = new Map();
    this.heads = new Map(); // target -> its button
    this.root.replaceChildren(...store.layout.map((group) => this.#group(group)));
    rove(this.root, ".part");
    for (const name of ["draft", "frame"]) store.addEventListener(name, () => this.update());
    this.update();
  }

  focus(slot = this.store.selected ?? this.store.looked) {
    (this.rows.get(id(slot)) ?? this.rows.values().next().value)?.button.focus();
  }

  update() {
    const { store } = this;
    const off = store.busy || store.ended || !store.isHere() || store.frame === store.bounds.first;
    const tabbed = store.selected ?? store.looked ?? store.slots()[0];
    for (const row of this.rows.values()) this.#show(row, off, tabbed);
    for (const [target, button] of this.heads) {
      const all = store.parts(target).every((slot) => store.missing(slot));
      write(button, all ? "There again" : "Not there");
      button.disabled = off;
    }
    this.follow(false);
  }

  #show({ slot, item, button, absent, told, sign }, off, tabbed) {
    const { store } = this;
    const around = store.around(slot);
    const state = around ? { kind: store.drafted(slot) ? "moved" : "" } : store.told(slot);
    const chosen = same(store.selected, slot) || same(store.looked, slot);
    item.classList.toggle("current", chosen);
    item.classList.toggle("armed", same(store.current, slot));
    item.dataset.kind = state.kind;
    item.dataset.doubt = String(state.kind === "lost" || (state.confidence ?? 1) < DOUBT);
    button.tabIndex = same(tabbed, slot) ? 0 : -1;
    if (chosen) button.setAttribute("aria-current", "true");
    else button.removeAttribute("aria-current");
    const use = state.kind === "init" && state.byHand ? "hand" : SIGNS[state.kind];
    sign.firstChild.setAttribute("href", use ? `#mark-${use}` : around ? "#icon-fit" : "#");
    write(told, around && !state.kind ? "places all anew" : words(state));
    if (!absent) return;
    absent.tabIndex = button.tabIndex;
    const missing = store.missing(slot);
    write(absent, missing ? "There again" : "Not there");
    absent.setAttribute(
      "aria-label",
      `${spoken(slot.part)} of ${spoken(slot.target)}: ${missing ? "there again" : "not there"}`,
    );
    absent.disabled = off || state.kind === "unknown";
  }

  /** The chosen row is kept in sight, the list alone being scrolled. */
  follow(anew = true) {
    const row = this.rows.get(id(this.store.selected ?? this.store.looked));
    if (!row || (row === this.followed && !anew)) return;
    this.followed = row;
    const scroller = $("panel-body");
    const [box, at] = [scroller.getBoundingClientRect(), row.item.getBoundingClientRect()];
    if (!at.height) return;
    if (at.top < box.top) scroller.scrollTop += at.top - box.top - 8;
    else if (at.bottom > box.bottom) scroller.scrollTop += at.bottom - box.bottom + 8;
  }

  #group({ target, box, points }) {
    const { store } = this;
    const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
    swatch.style.backgroundColor = colour(store, target);
    const parts = store.parts(target);
    if (!points.length) {
      // a target that is one box is one line
      const [item] = parts.map((slot) => this.#row(slot, swatch));
      return make("ul", { class: "target", "data-testid": `target-${target}` }, item);
    }
    const head = make("div", { class: "target-head" }, swatch, make("h3", { id: `target-${target}` }, spoken(target)));
    if (parts.length > 1) {
      const button = make("button", { class: "small absent", type: "button", "data-testid": `absent-${target}` });
      button.setAttribute("aria-describedby", `target-${target}`);
      button.addEventListener("click", () => this.absent(parts, !parts.every((slot) => store.missing(slot))));
      head.append(button);
      this.heads.set(target, button);
    }
    const slots = box === "no" ? parts : [...parts, { target, part: BOX }];
    const list = make("ul", { "aria-labelledby": `target-${target}` }, ...slots.map((slot) => this.#row(slot)));
    return make("section", { class: "target", "data-testid": `target-${target}` }, head, list);
  }

  #row(slot, swatch = null) {
    const { store } = this;
    const sign = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    sign.setAttribute("class", "sign");
    sign.setAttribute("aria-hidden", "true");
    sign.append(document.createElementNS("http://www.w3.org/2000/svg", "use"));
    const told = make("span", { class: "numbers" });
    const called = store.around(slot) ? "in a box" : spoken(swatch ? slot.target : slot.part);
    const name = make("span", { class: "name" }, called);
    const button = make(
      "button",
      { class: "part", type: "button", "data-slot": id(slot), "data-testid": `part-${slot.target}-${slot.part}` },
      sign,
      swatch,
      name,
      told,
    );
    button.addEventListener("click", (event) => this.choose(slot, event.detail === 0));
    let absent = null;
    if (!store.around(slot)) {
      absent = make("button", {
        class: "small absent",
        type: "button",
        "data-testid": `absent-${slot.target}-${slot.part}`,
      });
      absent.addEventListener("click", () => this.absent([slot], !store.missing(slot)));
    }
    const item = make("li", {}, button, absent);
    this.rows.set(id(slot), { slot, item, button, absent, told, sign });
    return item;
  }
}
