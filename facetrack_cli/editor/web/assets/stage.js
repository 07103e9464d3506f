// The canvas: the frame, how it lies in the window (zoom and pan), and layers that others draw upon it.

// Pixel centres are whole numbers in the picture, so pixel x spans x - 0.5 to x + 0.5.

const CLOSEST = 32; // CSS pixels for one of the picture
const MARGIN = 48; // CSS pixels that the picture's border may come in from the window's when zoomed
const REDUCED = [8, 4, 2];

export class Stage {
  constructor(canvas, size) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.size = size;
    this.box = { width: 1, height: 1 }; // of the canvas, CSS pixels
    this.ratio = 1;
    this.view = { scale: 1, x: 0, y: 0 }; // CSS pixels = (picture + 0.5) * scale + (x, y)
    this.fitted = true;
    this.picture = null;
    this.layers = []; // functions (context, stage), the lowest first
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

  /** How far the server may reduce the frame without a loss to the eye. */
  get reduce() {
    return REDUCED.find((factor) => this.view.scale * this.ratio * factor <= 1.05) ?? 1;
  }

  show(picture) {
    this.picture = picture;
    this.draw();
  }

  // --- places

  /** From the picture to CSS pixels from the canvas's corner. */
  place(x, y) {
    const { scale, x: left, y: top } = this.view;
    return [(x + 0.5) * scale + left, (y + 0.5) * scale + top];
  }

  /** From CSS pixels from the canvas's corner to the picture. */
  spot(x, y) {
    const { scale, x: left, y: top } = this.view;
    return [(x - left) / scale - 0.5, (y - top) / scale - 0.5];
  }

  // --- zoom and pan

  toFit() {
    this.fitted = true;
    this.#settle();
  }

  /** Zooms by `factor`; what is at (x, y), CSS pixels of the canvas, stays there: the middle if not given. */
  zoomBy(factor, x = this.box.width / 2, y = this.box.height / 2) {
    const before = this.view;
    const scale = Math.min(Math.max(before.scale * factor, this.fit), Math.max(CLOSEST, this.fit));
    const by = scale / before.scale;
    this.view = { scale, x: x - (x - before.x) * by, y: y - (y - before.y) * by };
    this.fitted = scale <= this.fit * 1.001;
    this.#settle();
  }

  panBy(dx, dy) {
    this.view.x += dx;
    this.view.y += dy;
    this.#settle();
  }

  /** Brings a place of the picture into the window, if it is not there. */
  reveal(x, y) {
    const [left, top] = this.place(x, y);
    const { width, height } = this.box;
    const edge = Math.min(60, width / 4, height / 4);
    const inside = (at, length) => Math.min(Math.max(at, edge), length - edge) - at;
    if (!this.fitted) this.panBy(inside(left, width), inside(top, height));
  }

  #settle() {
    const { box, size, view, fit } = this;
    if (this.fitted) view.scale = fit;
    const lie = (at, length, room) => {
      if (length <= room) return (room - length) / 2;
      return Math.min(Math.max(at, room - length - MARGIN), MARGIN);
    };
    view.x = lie(view.x, size[0] * view.scale, box.width);
    view.y = lie(view.y, size[1] * view.scale, box.height);
    this.onview();
    this.draw();
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const [x, y] = this.spot(this.box.width / 2, this.box.height / 2);
    this.ratio = window.devicePixelRatio || 1;
    this.box = { width, height };
    this.canvas.width = Math.round(width * this.ratio);
    this.canvas.height = Math.round(height * this.ratio);
    if (!this.fitted) {
      const [left, top] = this.place(x, y);
      this.view.x += width / 2 - left;
      this.view.y += height / 2 - top;
      this.view.scale = Math.max(this.view.scale, this.fit);
    }
    this.#settle();
  }

  // --- drawing

  draw() {
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      this.#paint();
    });
  }

  #paint() {
    const { context, ratio, view, picture, size } = this;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.box.width, this.box.height);
    if (picture) {
      // true pixels, not a blur, where each is large enough to be seen
      context.imageSmoothingEnabled = view.scale * ratio < 4;
      context.imageSmoothingQuality = "high";
      context.drawImage(picture.bitmap, view.x, view.y, size[0] * view.scale, size[1] * view.scale);
    }
    for (const layer of this.layers) layer(context, this);
  }
}
