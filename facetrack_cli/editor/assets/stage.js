// The canvas: the image of the frame, zoom and pan, and the layers that are drawn over it.
// Pixel centres are whole numbers in the image, so pixel x spans x - 0.5 to x + 0.5.

import { clamp } from "./geometry.js";

const CLOSEST = 32; // CSS pixels for one of the image
const CLOSE = 8; // the same, where the page chooses it
const ROOM = 3.5; // of a part of the frame that is shown, in terms of its longer side
const MARGIN = 48; // CSS pixels that the image's border may come in from the window's when zoomed
const REDUCED = [8, 4, 2];

export class Stage {
  constructor(canvas, size) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.size = size;
    this.box = { width: 1, height: 1 }; // of the canvas, CSS pixels
    this.ratio = 1;
    this.view = { scale: 1, x: 0, y: 0 }; // CSS pixels = (image + 0.5) * scale + (x, y)
    this.fitted = true;
    this.image = null; // {bitmap, index, reduce}
    this.layers = []; // functions (context, stage), drawn in this order
    this.onview = () => {};
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
  }

  get fit() {
    const [width, height] = this.size;
    return Math.min(this.box.width / width, this.box.height / height);
  }

  get zoom() {
    return this.view.scale / this.fit;
  }

  /** How far the server may reduce the image without a visible loss. */
  get reduce() {
    return REDUCED.find((factor) => this.view.scale * this.ratio * factor <= 1.05) ?? 1;
  }

  show(image) {
    this.image = image;
    this.draw();
  }

  // --- places

  /** From pixels of the image to CSS pixels of the canvas. */
  toCanvas(x, y) {
    const { scale, x: left, y: top } = this.view;
    return [(x + 0.5) * scale + left, (y + 0.5) * scale + top];
  }

  /** From CSS pixels of the canvas to pixels of the image. */
  toImage(x, y) {
    const { scale, x: left, y: top } = this.view;
    return [(x - left) / scale - 0.5, (y - top) / scale - 0.5];
  }

  // --- zoom and pan

  toFit() {
    this.fitted = true;
    this.#updateView();
  }

  /** Shows [left, top, right, bottom] of the frame, and as much around it. */
  toRegion([left, top, right, bottom]) {
    const { width, height } = this.box;
    const room = ROOM * Math.max(right - left, bottom - top, 1);
    const scale = clamp(Math.min(width, height) / room, this.fit, Math.max(this.fit, CLOSE));
    const middle = (low, high, length) => length / 2 - ((low + high) / 2 + 0.5) * scale;
    this.view = { scale, x: middle(left, right, width), y: middle(top, bottom, height) };
    this.fitted = scale <= this.fit * 1.001;
    this.#updateView();
  }

  /** Zooms by `factor`; (x, y), CSS pixels of the canvas, stays where it is: the middle if not given. */
  zoomBy(factor, x = this.box.width / 2, y = this.box.height / 2) {
    const before = this.view;
    const scale = clamp(before.scale * factor, this.fit, CLOSEST);
    const by = scale / before.scale;
    this.view = { scale, x: x - (x - before.x) * by, y: y - (y - before.y) * by };
    this.fitted = scale <= this.fit * 1.001;
    this.#updateView();
  }

  panBy(dx, dy) {
    this.view.x += dx;
    this.view.y += dy;
    this.#updateView();
  }

  /** Moves the image so that a place of it is visible. */
  reveal(x, y) {
    const [left, top] = this.toCanvas(x, y);
    const { width, height } = this.box;
    const edge = Math.min(60, width / 4, height / 4);
    const shift = (at, length) => clamp(at, edge, length - edge) - at;
    if (!this.fitted) this.panBy(shift(left, width), shift(top, height));
  }

  #updateView() {
    const { box, size, view, fit } = this;
    if (this.fitted) view.scale = fit;
    const offset = (at, length, room) => {
      if (length <= room) return (room - length) / 2;
      return clamp(at, room - length - MARGIN, MARGIN);
    };
    view.x = offset(view.x, size[0] * view.scale, box.width);
    view.y = offset(view.y, size[1] * view.scale, box.height);
    this.onview();
    this.draw();
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const [x, y] = this.toImage(this.box.width / 2, this.box.height / 2);
    this.ratio = window.devicePixelRatio || 1;
    this.box = { width, height };
    this.canvas.width = Math.round(width * this.ratio);
    this.canvas.height = Math.round(height * this.ratio);
    if (!this.fitted) {
      const [left, top] = this.toCanvas(x, y);
      this.view.x += width / 2 - left;
      this.view.y += height / 2 - top;
      this.view.scale = Math.max(this.view.scale, this.fit);
    }
    this.#updateView();
  }

  // --- drawing

  draw() {
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      this.#paint();
    });
  }

  #paint() {
    const { context, ratio, view, image, size } = this;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.box.width, this.box.height);
    if (image) {
      // sharp pixels where each is large enough to be seen
      context.imageSmoothingEnabled = view.scale * ratio < 4;
      context.imageSmoothingQuality = "high";
      context.drawImage(image.bitmap, view.x, view.y, size[0] * view.scale, size[1] * view.scale);
    }
    for (const layer of this.layers) layer(context, this);
  }
}
