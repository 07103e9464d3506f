// True pixels beside the pointer, with a cross hair: asked for without loss, and drawn without smoothing.

import * as api from "./api.js";

const AROUND = 64; // pixels of the picture that are asked for, to each side
const LARGEST = 208; // CSS pixels of a side
const LEAST = 112;
const FROM_TOUCH = 56; // CSS pixels from what points: a finger covers more
const FROM_MOUSE = 28;
const EDGE = 8;

export class Magnifier {
  constructor(canvas, stage, store) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.stage = stage;
    this.store = store;
    this.enabled = true;
    this.known = null; // {frame, x, y, w, h, bitmap}
    this.asked = null; // the request under way
    this.at = null;
  }

  /** Shows the picture around (x, y), pixels, beside what points there: "touch", "mouse" or "keys". */
  show(x, y, by, ink) {
    if (!this.enabled) return;
    clearTimeout(this.leave);
    this.at = { x, y, by, ink };
    this.canvas.hidden = false;
    this.#lie();
    this.#ask();
    this.#paint();
  }

  hide(after = 0) {
    clearTimeout(this.leave);
    this.leave = setTimeout(() => {
      this.at = null;
      this.canvas.hidden = true;
    }, after);
  }

  toggle() {
    this.enabled = !this.enabled;
    if (!this.enabled) this.hide();
    return this.enabled;
  }

  // beside the pointer and not lower, on the side that has room, smaller where neither has
  #lie() {
    const { x, y, by } = this.at;
    const corner = this.stage.canvas.getBoundingClientRect();
    const [sx, sy] = this.stage.place(x, y);
    const [px, py] = [corner.left + sx, corner.top + sy];
    const gap = by === "touch" ? FROM_TOUCH : FROM_MOUSE;
    const room = { left: px - gap - EDGE, right: window.innerWidth - px - gap - EDGE };
    const right = room.right >= LARGEST || room.right >= room.left;
    const side = Math.max(Math.min(LARGEST, right ? room.right : room.left, window.innerHeight / 3), LEAST);
    const left = right ? px + gap : px - gap - side;
    const fit = (value, length) => Math.min(Math.max(value, EDGE), length - side - EDGE);
    Object.assign(this.canvas.style, {
      width: `${side}px`,
      height: `${side}px`,
      left: `${fit(left, window.innerWidth)}px`,
      top: `${fit(py - side * 0.8, window.innerHeight)}px`,
    });
    this.side = side;
    const ratio = window.devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(side * ratio)) {
      this.canvas.width = this.canvas.height = Math.round(side * ratio);
    }
  }

  get #reach() {
    return this.side / 2 / this.#times; // pixels of the picture to each side that are seen
  }

  // always more than the picture itself shows
  get #times() {
    return Math.min(Math.max(8, Math.ceil(this.stage.view.scale * 2)), 40);
  }

  #covers() {
    const { known, at, store } = this;
    if (!known || known.frame !== store.frame) return false;
    const [width, height] = this.stage.size;
    const reach = this.#reach + 1;
    return (
      known.x <= Math.max(at.x - reach, 0) &&
      known.y <= Math.max(at.y - reach, 0) &&
      known.x + known.w >= Math.min(at.x + reach, width) &&
      known.y + known.h >= Math.min(at.y + reach, height)
    );
  }

  async #ask() {
    if (this.asked || !this.at || this.#covers()) return;
    const [width, height] = this.stage.size;
    const low = (value, length) => Math.min(Math.max(Math.round(value) - AROUND, 0), length - 1);
    const [x, y] = [low(this.at.x, width), low(this.at.y, height)];
    const [w, h] = [Math.min(2 * AROUND + 1, width - x), Math.min(2 * AROUND + 1, height - y)];
    const frame = this.store.frame;
    this.asked = { frame, x, y };
    try {
      const bitmap = await createImageBitmap(await api.crop(frame, x, y, w, h));
      this.known?.bitmap.close?.();
      this.known = { frame, x, y, w, h, bitmap };
      this.asked = null;
      this.#paint();
      this.#ask();
    } catch {
      this.asked = null; // the picture as it is shown serves until the next time
    }
  }

  #paint() {
    if (!this.at) return;
    const { context, stage, side, at } = this;
    const ratio = window.devicePixelRatio || 1;
    const times = this.#times;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = "#0b0e11";
    context.fillRect(0, 0, side, side);
    context.imageSmoothingEnabled = false;
    const from = (left, top) => [side / 2 + (left - 0.5 - at.x) * times, side / 2 + (top - 0.5 - at.y) * times];
    const { picture } = stage;
    if (picture?.index === this.store.frame) {
      context.drawImage(picture.bitmap, ...from(0, 0), stage.size[0] * times, stage.size[1] * times);
    }
    const { known } = this;
    if (known?.frame === this.store.frame) {
      context.drawImage(known.bitmap, ...from(known.x, known.y), known.w * times, known.h * times);
    }
    this.#cross(times);
  }

  #cross(times) {
    const { context, side, at } = this;
    const middle = side / 2;
    const free = Math.max(times * 0.75, 6); // the pixel that is meant stays free
    context.beginPath();
    for (const sign of [-1, 1]) {
      context.moveTo(middle + sign * free, middle);
      context.lineTo(middle + sign * middle, middle);
      context.moveTo(middle, middle + sign * free);
      context.lineTo(middle, middle + sign * middle);
    }
    context.lineWidth = 3;
    context.strokeStyle = "rgb(0 0 0 / 55%)";
    context.stroke();
    context.lineWidth = 1;
    context.strokeStyle = at.ink;
    context.stroke();
    context.fillStyle = at.ink;
    context.fillRect(middle - 1, middle - 1, 2, 2);
    const words = `${at.x.toFixed(2).replace(/\.?0+$/, "")}, ${at.y.toFixed(2).replace(/\.?0+$/, "")}`;
    context.font = "600 12px system-ui, sans-serif";
    const width = context.measureText(words).width;
    context.fillStyle = "rgb(10 14 18 / 78%)";
    context.fillRect(0, side - 20, width + 14, 20);
    context.fillStyle = "#fff";
    context.textBaseline = "middle";
    context.fillText(words, 7, side - 9.5);
  }
}
