// Which frames to review: those of low confidence, and what was corrected, as lists and by keys.

import { $, button, icon, make, percent, readable, rovingFocus, say, setText } from "./dom.js";
import { label } from "./draw.js";

const FEW = 3; // names of parts in a line

export class Review {
  /** `remove(correction)` is called by its button. */
  constructor(store, remove) {
    Object.assign(this, { store, remove });
    this.frames = []; // {frame, parts, key}, the worst first
    this.corrections = [];
    this.seen = new Set();
    this.shape = "";
    rovingFocus($("review"), ".goes");
    rovingFocus($("corrections"), ".goes");
    store.addEventListener("frame", () => this.#showCurrent());
    store.addEventListener("draft", () => this.#update());
  }

  show({ doubtful, corrections }) {
    const frames = new Map();
    for (const one of doubtful) {
      if (!frames.has(one.frame)) frames.set(one.frame, { frame: one.frame, parts: [] });
      frames.get(one.frame).parts.push(one);
    }
    this.frames = [...frames.values()];
    for (const one of this.frames) {
      // a frame that was tracked again is to be reviewed again
      one.key = `${one.frame} ${one.parts.map(({ target, part, confidence }) => [target, part, confidence]).join(" ")}`;
    }
    this.corrections = corrections;
    this.#update();
  }

  // --- from one to the next

  next(direction) {
    const to = this.#nearest(this.frames, direction);
    const none = `No frame to review ${direction > 0 ? "after" : "before"} this one.`;
    if (to) this.#showFrame(to);
    else say(this.frames.length ? none : "There is no frame to review.");
  }

  worst() {
    const to = this.frames.find(({ key }) => !this.seen.has(key));
    if (to) this.#showFrame(to);
    else say(this.frames.length ? "You have reviewed every frame of the list." : "There is no frame to review.");
  }

  nextCorrection(direction) {
    const to = this.#nearest(this.corrections, direction);
    const none = `No correction ${direction > 0 ? "after" : "before"} this frame.`;
    if (to) this.#showCorrection(to);
    else say(this.corrections.length ? none : "Nothing is corrected.");
  }

  // the next in one direction, 1 or -1
  #nearest(all, direction) {
    const sorted = [...all].sort((a, b) => direction * (a.frame - b.frame));
    return sorted.find(({ frame }) => direction * (frame - this.store.frame) > 0);
  }

  #showFrame(one) {
    const [{ target, part }] = one.parts;
    this.seen.add(one.key);
    this.store.jump(one.frame, { target, part });
    const lost = isLost(one) ? "lost, " : "";
    say(`Frame ${one.frame}: ${this.#names(one.parts)}, ${lost}${percent(one.parts[0].confidence)}`, "quiet");
  }

  #showCorrection(one) {
    const [part] = placed(one);
    this.store.jump(one.frame, part ? { target: one.target, part } : null);
    say(`Frame ${one.frame}: ${readable(one.target)}, ${describe(one)}`, "quiet");
  }

  // --- the lists

  #update() {
    const { store, frames, corrections } = this;
    const shape = JSON.stringify([frames, corrections, [...this.seen], store.busy, store.ended]);
    if (shape !== this.shape) {
      this.shape = shape;
      const focused = document.activeElement?.dataset?.goes;
      $("review").replaceChildren(...frames.map((one) => this.#frameItem(one)));
      $("corrections").replaceChildren(...corrections.map((one) => this.#correctionItem(one)));
      if (focused) document.querySelector(`[data-goes="${focused}"]`)?.focus();
      for (const id of ["review", "corrections"]) {
        const [first] = $(id).querySelectorAll(".goes");
        if (first && !$(id).contains(document.activeElement)) first.tabIndex = 0;
      }
    }
    setText($("review-count"), frames.length ? String(frames.length) : "");
    setText($("corrections-count"), corrections.length ? String(corrections.length) : "");
    const none = "No part is lost or doubtful.";
    setText($("review-note"), frames.length ? "The worst frame first. Frames in grey are reviewed." : none);
    $("corrections-note").hidden = corrections.length > 0;
    $("review-next").disabled = $("review-previous").disabled = !frames.length;
    this.#showCurrent();
  }

  #names(parts) {
    const names = parts.map((one) => readable(label(this.store, one)));
    return names.length > FEW ? `${names.slice(0, FEW).join(", ")}, ${names.length - FEW} more` : names.join(", ");
  }

  #frameItem(one) {
    const lost = isLost(one);
    const seen = this.seen.has(one.key);
    const goes = button(
      `review-${one.frame}`,
      { class: "goes", tabindex: "-1", "data-goes": `r${one.frame}`, click: () => this.#showFrame(one) },
      make("span", { class: "at" }, String(one.frame)),
      make("span", { class: "what" }, this.#names(one.parts)),
      make(
        "span",
        { class: `confidence${lost ? " bad" : ""}` },
        `${lost ? "lost " : ""}${percent(one.parts[0].confidence)}`,
      ),
      make("span", { class: "visually-hidden" }, seen ? ", reviewed" : ""),
    );
    return make("li", { class: seen ? "seen" : null, "data-frame": one.frame }, goes);
  }

  #correctionItem(one) {
    const { frame, target } = one;
    const { busy, ended, layout } = this.store;
    const goes = button(
      `correction-${frame}-${target}`,
      { class: "goes", tabindex: "-1", "data-goes": `c${frame}${target}`, click: () => this.#showCorrection(one) },
      make("span", { class: "at" }, String(frame)),
      make("span", { class: "what" }, `${layout.length > 1 ? `${readable(target)}: ` : ""}${describe(one)}`),
    );
    const remove = button(
      `uncorrect-${frame}-${target}`,
      {
        class: "clear",
        disabled: busy || ended,
        "aria-label": `Remove the correction of ${readable(target)} in frame ${frame}`,
        title: "Remove, and track again",
        click: () => this.remove(one),
      },
      icon("icon-cross"),
    );
    return make("li", { "data-frame": frame }, goes, remove);
  }

  #showCurrent() {
    for (const item of document.querySelectorAll("#review > li, #corrections > li")) {
      item.classList.toggle("current", Number(item.dataset.frame) === this.store.frame);
    }
  }
}

const isLost = ({ parts }) => parts.some(({ status }) => status === "lost");

const placed = ({ box, points }) => (box ? ["box"] : Object.keys(points));

// a correction in a few words
function describe(one) {
  const { target, absent, confirmed } = one;
  const names = (list) => list.map(readable).join(", ");
  if (confirmed === true || confirmed[0] === "box") return "confirmed";
  if (confirmed.length) return `${names(confirmed)} confirmed`;
  const moved = placed(one);
  const marked = absent === true ? "absent" : absent.length && `${names(absent)} absent`;
  return [moved.length && `${names(moved)} by hand`, marked].filter(Boolean).join("; ") || `${readable(target)} begins again`;
}
