// The pixels under the pointer, magnified, with a cross hair, and without smoothing.

import { formatNumber } from "./dom.js";
import { LABEL_FONT, LABEL_GROUND } from "./draw.js";
import { clamp } from "./geometry.js";

const LARGEST = 208; // CSS pixels of a side
const LEAST = 112;
const FROM_TOUCH = 56; // CSS pixels from the pointer: a finger covers more
const FROM_MOUSE = 28;
const EDGE = 8;

export class Magnifier {
  /** `want` is called when the magnifier is shown, and has all pixels of the frame requested. */
  constructor(canvas, stage, store, want) {
    Object.assign(this, { canvas, stage, store, want, enabled: true, at: null });
    this.context = canvas.getContext("2d");
    window.addEventListener("resize", () => this.#hideNow());
    store.addEventListener("frame", () => this.#hideNow());
  }

  /** Shows the frame around (x, y), pixels, beside the pointer: "touch", "mouse" or "keys". */
  show(x, y, by, ink) {
    if (!this.enabled) return;
    clearTimeout(this.hiding);
    this.at = { x, y, by, ink };
    this.canvas.hidden = false;
    this.#place();
    this.paint();
    if (this.stage.image?.reduce > 1) this.want();
  }

  hide(after = 0) {
    clearTimeout(this.hiding);
    this.hiding = setTimeout(() => this.#hideNow(), after);
  }

  #hideNow() {
    this.at = null;
    this.canvas.hidden = true;
  }

  toggle() {
    this.enabled = !this.enabled;
    if (!this.enabled) this.hide();
    return this.enabled;
  }

  // beside the pointer and not lower, on the side that has room, smaller where neither has
  #place() {
    const { x, y, by } = this.at;
    const corner = this.stage.canvas.getBoundingClientRect();
    const [sx, sy] = this.stage.toCanvas(x, y);
    const [px, py] = [corner.left + sx, corner.top + sy];
    const gap = by === "touch" ? FROM_TOUCH : FROM_MOUSE;
    const room = { left: px - gap - EDGE, right: window.innerWidth - px - gap - EDGE };
    const right = room.right >= LARGEST || room.right >= room.left;
    const side = Math.max(Math.min(LARGEST, right ? room.right : room.left, window.innerHeight / 3), LEAST);
    const left = right ? px + gap : px - gap - side;
    const fit = (value, length) => clamp(value, EDGE, length - side - EDGE);
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

  // always larger than the canvas shows them
  get #times() {
    return clamp(Math.ceil(this.stage.view.scale * 2), 8, 40);
  }

  /** Also when the image has become finer. */
  paint() {
    if (!this.at) return;
    const { context, stage, side, at } = this;
    const ratio = window.devicePixelRatio || 1;
    const times = this.#times;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = "#0b0e11";
    context.fillRect(0, 0, side, side);
    context.imageSmoothingEnabled = false;
    const from = (left, top) => [side / 2 + (left - 0.5 - at.x) * times, side / 2 + (top - 0.5 - at.y) * times];
    const { image } = stage;
    if (image?.index === this.store.frame) {
      context.drawImage(image.bitmap, ...from(0, 0), stage.size[0] * times, stage.size[1] * times);
    }
    this.#cross(times);
  }

  #cross(times) {
    const { context, side, at } = this;
    const middle = side / 2;
    const free = Math.max(times * 0.75, 6); // the pixel in the middle stays visible
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
    const text = `${formatNumber(at.x)}, ${formatNumber(at.y)}`;
    context.font = LABEL_FONT;
    const width = context.measureText(text).width;
    context.fillStyle = LABEL_GROUND;
    context.fillRect(0, side - 20, width + 14, 20);
    context.fillStyle = "#fff";
    context.textBaseline = "middle";
    context.fillText(text, 7, side - 9.5);
  }
}
