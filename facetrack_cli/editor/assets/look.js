// What a run found: the video, and below it measures and events over the same time.

import * as api from "./api.js";
import { $, button, drawn, make, readable, say, setText } from "./dom.js";

const [WIDTH, HEIGHT] = [1000, 40];
const FIRST = 8; // curves that are shown at first

const clock = (s) => `${Math.floor(s / 60)}:${(s % 60).toFixed(1).padStart(4, "0")}`;

export class Look {
  constructor({ open, exportMenu, back }) {
    Object.assign(this, { open, exportMenu, back, id: 0, clip: null, found: null });
    $("movie").addEventListener("timeupdate", () => this.#point());
    $("who").addEventListener("change", () => this.#draw());
    document.addEventListener("keydown", (event) => event.key === "Escape" && this.id && back());
  }

  /** The clip of this id; 0: the list. */
  async show(id, state) {
    this.id = id;
    $("look-view").hidden = !id;
    $("list-view").hidden = !!id;
    $("movie").pause();
    const clip = state.clips.find((one) => one.id === id);
    if (!clip) return id ? this.back() : undefined;
    this.clip = clip;
    window.scrollTo(0, 0);
    setText($("look-name"), clip.name);
    document.title = `${clip.name} – facetrack`;
    setText($("look-note"), readable(clip.look ?? ""));
    $("movie").hidden = !clip.movie;
    if (clip.movie) $("movie").src = `api/video?clip=${id}&v=${encodeURIComponent(clip.movie)}`;
    const menu = make("select", { "data-testid": "look-export", "aria-label": `Export ${clip.name}` });
    this.exportMenu(menu, "Export …", Object.entries(state.programs), `export?clip=${id}`);
    const correct = button("look-correct", { class: "primary", click: () => this.open(clip, "correct") }, "Correct");
    correct.hidden = clip.state !== "done";
    $("look-actions").replaceChildren(correct, menu);
    $("curves").replaceChildren();
    $("events").replaceChildren();
    $("back").focus();
    try {
      const found = await api.look(id);
      if (this.id !== id) return;
      this.found = found;
      $("who").replaceChildren(...found.targets.map((one) => make("option", { value: one.name }, readable(one.name))));
      this.#draw();
    } catch (error) {
      say(error.message, "error");
    }
  }

  update(state) {
    if (!this.id) document.title = "facetrack";
    const clip = state.clips.find((one) => one.id === this.id);
    if (clip && this.clip && clip.movie !== this.clip.movie) this.show(this.id, state); // it was corrected
  }

  get #span() {
    return Math.max(this.found.end - this.found.begin, 1e-6);
  }

  #draw() {
    const { found } = this;
    const target = found.targets.find((one) => one.name === $("who").value) ?? found.targets[0];
    $("who").parentElement.hidden = !target;
    if (!target) return;
    const events = found.events.filter((one) => one.target === target.name);
    const tiers = [...new Set(events.map((one) => one.tier))];
    const curves = target.curves.filter((one) => one.values.some((value) => value !== null));
    const parts = [
      ...tiers.map((tier) => this.#spans(tier, events.filter((one) => one.tier === tier))),
      ...curves.slice(0, FIRST).map((one) => this.#curve(one)),
    ];
    $("curves").replaceChildren(...parts);
    if (curves.length > FIRST) {
      const more = button("more-curves", { class: "small", click: () => more.replaceWith(...curves.slice(FIRST).map((one) => this.#curve(one))) }, `${curves.length - FIRST} more measures`);
      $("curves").append(more);
    }
    const items = events.map((one) => {
      const click = () => this.#seek(one.begin_s);
      return make("li", {}, button("event", { class: "event", click }, make("b", {}, clock(one.begin_s)), ` ${readable(one.tier)}: ${readable(one.value)}`, make("span", { class: "quiet" }, ` ${(one.end_s - one.begin_s).toFixed(2)} s`)));
    });
    $("events").replaceChildren(...(items.length ? items : [make("li", { class: "quiet" }, "None were found.")]));
    this.#point();
  }

  #row(label, range) {
    const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", "aria-hidden": "true" });
    svg.addEventListener("pointerdown", (event) => {
      const box = svg.getBoundingClientRect();
      this.#seek(this.found.begin + ((event.clientX - box.left) / box.width) * this.#span);
    });
    return [svg, make("div", { class: "curve" }, make("span", {}, label, make("small", {}, range)), svg)];
  }

  #x(time) {
    return ((time - this.found.begin) / this.#span) * WIDTH;
  }

  #spans(tier, events) {
    const [svg, row] = this.#row(readable(tier), String(events.length));
    for (const { begin_s: begin, end_s: end } of events) {
      svg.append(drawn("rect", { x: this.#x(begin), y: 8, width: Math.max(this.#x(end) - this.#x(begin), 1.5), height: 24 }));
    }
    return row;
  }

  #curve({ name, unit, values }) {
    const known = values.filter((value) => value !== null);
    const sure = name === "confidence";
    const [low, high] = sure ? [0, 1] : [Math.min(...known), Math.max(...known)];
    const text = (value) => (sure ? `${Math.round(100 * value)} %` : String(Number(value.toPrecision(2))));
    const [svg, row] = this.#row(readable(name), `${text(low)} to ${text(high)}${unit === "ratio" || !unit ? "" : ` ${readable(unit)}`}`);
    let path = "";
    let gap = true;
    values.forEach((value, k) => {
      if (value !== null) {
        const y = HEIGHT - 3 - ((value - low) / (high - low || 1)) * (HEIGHT - 6);
        path += `${gap ? "M" : "L"}${((k / Math.max(values.length - 1, 1)) * WIDTH).toFixed(1)} ${y.toFixed(1)}`;
      }
      gap = value === null;
    });
    svg.append(drawn("path", { d: path }));
    return row;
  }

  // the video begins with the first frame that was tracked
  #seek(time) {
    $("movie").currentTime = Math.max(time - this.found.begin, 0);
    this.#point();
  }

  #point() {
    if (!this.found) return;
    const time = this.found.begin + $("movie").currentTime;
    setText($("at"), clock(time));
    for (const svg of $("curves").querySelectorAll("svg")) {
      let line = svg.querySelector("line");
      if (!line) svg.append((line = drawn("line", { y1: 0, y2: HEIGHT })));
      for (const end of ["x1", "x2"]) line.setAttribute(end, this.#x(time));
    }
  }
}
