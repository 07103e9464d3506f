// The run under the slider: confidence as a curve, what is lost or absent, the corrections, the frame that is shown.

import { $, plural } from "./dom.js";
import { diamondPath } from "./draw.js";
import { clamp } from "./geometry.js";

const SLIDER = 8; // CSS pixels from its end to the middle of its thumb: the frames are below it
const STRIP = 5; // CSS pixels below the curve: lost and absent
const HEAD = 11; // above it: corrections
const RESIZED = 150; // ms after the last change of size
const DARK = window.matchMedia("(prefers-color-scheme: dark)");

export class Timeline {
  /** `request(bins)` is called when the overview is needed with so many bins. */
  constructor(store, request) {
    Object.assign(this, { store, request });
    this.canvas = $("timeline");
    this.context = this.canvas.getContext("2d");
    this.overview = null;
    this.bins = 0;
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
    for (const name of ["frame", "draft"]) store.addEventListener(name, () => this.draw());
    DARK.addEventListener("change", () => this.draw());
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.#go(event);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (this.canvas.hasPointerCapture(event.pointerId)) this.#go(event);
    });
    this.#resize();
  }

  show(overview) {
    this.overview = overview;
    const { doubtful, corrections } = overview;
    const counts = `${plural(doubtful.length, "stretch", "stretches")} to review, ${plural(corrections.length, "correction")}`;
    this.canvas.setAttribute("aria-label", `Confidence over the clip: ${counts}`);
    this.draw();
  }

  #go(event) {
    const { left } = this.canvas.getBoundingClientRect();
    const { first, last } = this.store.bounds;
    const share = (event.clientX - left - SLIDER) / Math.max(this.width - 2 * SLIDER, 1);
    this.store.show(first + clamp(share, 0, 1) * (last - first));
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    Object.assign(this, { width, height, ratio });
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.#paint();
    const bins = Math.max(Math.round(width - 2 * SLIDER), 1);
    clearTimeout(this.timer);
    if (bins === this.bins) return;
    this.timer = setTimeout(
      () => {
        this.bins = bins;
        this.request(bins);
      },
      this.bins ? RESIZED : 0,
    );
  }

  draw() {
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      this.#paint();
    });
  }

  /** The place of a frame, CSS pixels. */
  at(frame) {
    const { first, last } = this.store.bounds;
    return SLIDER + ((frame - first) / Math.max(last - first, 1)) * (this.width - 2 * SLIDER);
  }

  #paint() {
    const { context, width, height, ratio, store } = this;
    if (!width) return;
    const known = new Map(); // colours of the scheme, which only a style resolves
    const ink = (name) => {
      if (known.has(name)) return known.get(name);
      this.canvas.style.color = `var(--${name})`;
      known.set(name, getComputedStyle(this.canvas).color);
      return known.get(name);
    };
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const [top, bottom] = [HEAD, height - STRIP - 1];
    context.fillStyle = ink("curve-ground");
    context.fillRect(SLIDER - 2, top, width - 2 * SLIDER + 4, height - top);
    if (this.overview) this.#curve(top, bottom, ink);
    for (const { frame } of this.overview?.corrections ?? []) this.#diamond(frame, ink("ink"), true, ink);
    if (!store.isEmpty()) this.#diamond(store.draft.frame, ink("ink"), false, ink);
    const x = Math.round(this.at(store.frame));
    context.fillStyle = ink("raised");
    context.fillRect(x - 2, top - 1, 4, height - top + 1);
    context.fillStyle = ink("ink");
    context.fillRect(x - 1, top - 3, 2, height - top + 3);
  }

  #curve(top, bottom, ink) {
    const { context, overview } = this;
    const { first, last, least, lost, absent } = overview;
    const frames = last - first + 1;
    const bins = least.length;
    const edge = (bin) => first + Math.floor((bin * frames) / bins);
    const whole = (x) => Math.round(x * this.ratio) / this.ratio; // or the seams would be visible
    const [left, right] = [SLIDER - 2, this.width - SLIDER + 2];
    const side = (bin) => whole(clamp(this.at(edge(bin) - 0.5), left, right));
    const level = (value) => bottom - value * (bottom - top);
    // [x0, y, x1] of the curve, null where nothing is known
    const steps = least.map((value, bin) => (value === null ? null : [side(bin), level(value), side(bin + 1)]));
    for (let bin = 0; bin < bins; bin++) {
      const [x0, width] = [side(bin), side(bin + 1) - side(bin)];
      if (lost[bin]) {
        context.fillStyle = ink("curve-lost-fill");
        context.fillRect(x0, top, width, bottom - top);
      }
      if (!lost[bin] && !absent[bin]) continue;
      const from = !lost[bin] && absent[bin] === 2 ? top : bottom + 1;
      context.fillStyle = ink(lost[bin] ? "curve-lost" : "curve-absent");
      context.fillRect(x0, from, Math.max(width, 1.5), this.height - from);
    }
    context.beginPath();
    for (const step of steps) {
      if (step) context.rect(step[0], step[1], step[2] - step[0], bottom - step[1]);
    }
    context.fillStyle = ink("curve-fill");
    context.fill();
    context.beginPath();
    steps.forEach((step, bin) => {
      if (!step) return;
      const [x0, y, x1] = step;
      if (bin && steps[bin - 1]) context.lineTo(x0, y);
      else context.moveTo(x0, y);
      context.lineTo(x1, y);
    });
    context.lineWidth = 1.25;
    context.lineJoin = "round";
    context.strokeStyle = ink("curve-line");
    context.stroke();
  }

  #diamond(frame, colour, full, ink) {
    const { context } = this;
    diamondPath(context, this.at(frame), 5, 4.5);
    context.fillStyle = full ? colour : ink("raised");
    context.fill();
    context.lineWidth = 1.5;
    context.strokeStyle = colour;
    context.stroke();
  }
}
