// Where to look: the frames of least confidence, and what was corrected, as lists and by keys.

import { $, icon, make, rove, spoken, write } from "./dom.js";
import { label } from "./draw.js";

const FEW = 3; // names of parts in a line

export class Doubtful {
  /** `remove(correction)` is called by its button. */
  constructor(store, { say, remove }) {
    Object.assign(this, { store, say, remove });
    this.frames = []; // {frame, parts, key}, the worst first
    this.corrections = [];
    this.seen = new Set();
    this.shape = "";
    rove($("doubtful"), ".goes");
    rove($("corrections"), ".goes");
    store.addEventListener("frame", () => this.#here());
    store.addEventListener("draft", () => this.#list());
  }

  show({ doubtful, corrections }) {
    const frames = new Map();
    for (const one of doubtful) {
      if (!frames.has(one.frame)) frames.set(one.frame, { frame: one.frame, parts: [] });
      frames.get(one.frame).parts.push(one);
    }
    this.frames = [...frames.values()];
    for (const one of this.frames) {
      // what was tracked anew is another doubt
      one.key = `${one.frame} ${one.parts.map(({ target, part, confidence }) => [target, part, confidence]).join(" ")}`;
    }
    this.corrections = corrections;
    this.#list();
  }

  // --- from one to the next

  next(way) {
    const sorted = [...this.frames].sort((a, b) => way * (a.frame - b.frame));
    const to = sorted.find(({ frame }) => way * (frame - this.store.frame) > 0);
    if (to) this.#look(to);
    else
      this.say(
        this.frames.length ? `No doubtful frame ${way > 0 ? "after" : "before"} this one.` : "No frame is doubtful.",
      );
  }

  worst() {
    const to = this.frames.find(({ key }) => !this.seen.has(key));
    if (to) this.#look(to);
    else this.say(this.frames.length ? "Every doubtful frame was looked at." : "No frame is doubtful.");
  }

  nextCorrection(way) {
    const sorted = [...this.corrections].sort((a, b) => way * (a.frame - b.frame));
    const to = sorted.find(({ frame }) => way * (frame - this.store.frame) > 0);
    if (to) this.#visit(to);
    else if (!this.corrections.length) this.say("Nothing is corrected.");
    else this.say(`No correction ${way > 0 ? "after" : "before"} this frame.`);
  }

  #look(one) {
    const [{ target, part }] = one.parts;
    this.seen.add(one.key);
    this.store.jump(one.frame, { target, part });
    this.say(`Frame ${one.frame}: ${this.#told(one)}`, "quiet");
  }

  #visit(one) {
    this.store.jump(one.frame, one.parts.length ? { target: one.target, part: one.parts[0] } : null);
    this.say(`Frame ${one.frame}: ${spoken(one.target)}, ${this.#what(one)}`, "quiet");
  }

  // --- words

  #names(parts) {
    const names = parts.map((one) => spoken(label(this.store, one)));
    return names.length > FEW ? `${names.slice(0, FEW).join(", ")}, ${names.length - FEW} more` : names.join(", ");
  }

  #told({ parts }) {
    const sure = `${Math.round(parts[0].confidence * 100)} %`;
    return `${this.#names(parts)}, ${parts.some(({ status }) => status === "lost") ? "lost, " : ""}${sure}`;
  }

  #what({ target, parts, absent }) {
    const words = [];
    const names = (list) => list.map(spoken).join(", ");
    if (parts.length) words.push(parts[0] === "box" ? "box by hand" : `${names(parts)} by hand`);
    const all = absent === true;
    if (all) words.push("not there");
    else if (absent.length) words.push(`${names(absent)} not there`);
    return words.join("; ") || `${spoken(target)} begins anew`;
  }

  // --- the lists

  #list() {
    const { store } = this;
    const shape = JSON.stringify([this.frames, this.corrections, [...this.seen], store.busy, store.ended]);
    if (shape !== this.shape) {
      this.shape = shape;
      const focused = document.activeElement?.dataset?.goes;
      $("doubtful").replaceChildren(...this.frames.map((one) => this.#frame(one)));
      $("corrections").replaceChildren(...this.corrections.map((one) => this.#correction(one)));
      if (focused) document.querySelector(`[data-goes="${focused}"]`)?.focus();
      for (const id of ["doubtful", "corrections"]) {
        const [first] = $(id).querySelectorAll(".goes");
        if (first && !$(id).contains(document.activeElement)) first.tabIndex = 0;
      }
    }
    write($("doubtful-count"), this.frames.length ? String(this.frames.length) : "");
    write($("corrections-count"), this.corrections.length ? String(this.corrections.length) : "");
    const none = "No part is lost, and none has a confidence below 50 %.";
    write($("doubtful-note"), this.frames.length ? "The worst first; grey is what was looked at." : none);
    write(
      $("corrections-note"),
      this.corrections.length ? "" : "Nothing is corrected yet. Drag what is wrong, then track from there.",
    );
    $("corrections-note").hidden = !!this.corrections.length;
    $("doubt-on").disabled = $("doubt-back").disabled = !this.frames.length;
    this.#here();
  }

  #frame(one) {
    const lost = one.parts.some(({ status }) => status === "lost");
    const seen = this.seen.has(one.key);
    const sure = `${lost ? "lost " : ""}${Math.round(one.parts[0].confidence * 100)} %`;
    const button = make(
      "button",
      {
        type: "button",
        class: "goes",
        tabindex: "-1",
        "data-goes": `d${one.frame}`,
        "data-testid": `doubtful-${one.frame}`,
      },
      make("span", { class: "at" }, String(one.frame)),
      make("span", { class: "what" }, this.#names(one.parts)),
      make("span", { class: `sure${lost ? " bad" : ""}` }, sure),
      make("span", { class: "unseen" }, seen ? ", looked at" : ""),
    );
    button.addEventListener("click", () => this.#look(one));
    return make("li", { class: seen ? "seen" : null, "data-frame": one.frame }, button);
  }

  #correction(one) {
    const { frame, target } = one;
    const button = make(
      "button",
      {
        type: "button",
        class: "goes",
        tabindex: "-1",
        "data-goes": `c${frame}${target}`,
        "data-testid": `correction-${frame}-${target}`,
      },
      make("span", { class: "at" }, String(frame)),
      make(
        "span",
        { class: "what" },
        this.store.layout.length > 1 ? `${spoken(target)}: ${this.#what(one)}` : this.#what(one),
      ),
    );
    button.addEventListener("click", () => this.#visit(one));
    const remove = make(
      "button",
      {
        type: "button",
        class: "clear",
        "data-testid": `uncorrect-${frame}-${target}`,
        disabled: this.store.busy || this.store.ended,
      },
      icon("cross"),
    );
    remove.setAttribute("aria-label", `Remove the correction of ${spoken(target)} in frame ${frame}`);
    remove.title = "Remove, and track anew";
    remove.addEventListener("click", () => this.remove(one));
    return make("li", { "data-frame": frame }, button, remove);
  }

  #here() {
    for (const item of document.querySelectorAll("#doubtful > li, #corrections > li")) {
      item.classList.toggle("current", Number(item.dataset.frame) === this.store.frame);
    }
  }
}
