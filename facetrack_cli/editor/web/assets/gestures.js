// Mouse, finger and pen on the canvas: place, draw, move, resize; pan, pinch, wheel.

import { between, held, inside, resized, snapped } from "./actions.js";
import { colour, edges, handles } from "./draw.js";
import { BOX, LEAST_BOX, same } from "./store.js";

const SLOP = { mouse: 3, touch: 8 }; // CSS pixels that are no movement yet
const REACH = { mouse: 9, touch: 22 }; // of a mark
const DRAWN = 8; // CSS pixels of a press that was meant to draw a box

/** `may()` says whether marks may be changed now, and tells the user why if not. */
export class Gestures {
  constructor(stage, store, magnifier, { may, say }) {
    Object.assign(this, { stage, store, magnifier, may, say });
    this.pointers = new Map();
    this.doing = null; // {move(x, y), end(moved), touch}
    this.hovered = null;
    this.panning = false; // while the space bar is down
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.#up(event));
    canvas.addEventListener("pointerleave", () => this.#hover(null));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  #at(event) {
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  #down(event) {
    const kind = event.pointerType === "mouse" ? "mouse" : "touch";
    if (kind === "mouse" && event.button > 1) return;
    event.preventDefault();
    this.stage.canvas.focus({ preventScroll: true });
    this.stage.canvas.setPointerCapture(event.pointerId);
    const [x, y] = this.#at(event);
    this.pointers.set(event.pointerId, { x, y });
    if (this.pointers.size > 1) {
      this.cancel(); // a second finger: the first one did not mean to draw
      this.doing = this.pointers.size === 2 ? this.#pinch() : null;
      return;
    }
    this.from = { x, y, kind, moved: false };
    this.doing = event.button === 1 || this.panning ? this.#pan() : this.#meant(x, y, kind);
    this.doing.start?.();
  }

  #move(event) {
    const [x, y] = this.#at(event);
    const known = this.pointers.get(event.pointerId);
    if (!known) {
      if (event.pointerType === "mouse") this.#hover([x, y]);
      return;
    }
    const [dx, dy] = [x - known.x, y - known.y];
    Object.assign(known, { x, y });
    if (!this.doing) return;
    if (this.pointers.size > 1) return this.doing.move(x, y, dx, dy);
    const { from } = this;
    if (!from.moved && Math.hypot(x - from.x, y - from.y) <= SLOP[from.kind]) return;
    if (from.moved) return this.doing.move(x, y, dx, dy);
    from.moved = true;
    this.doing.move(x, y, x - from.x, y - from.y);
  }

  #up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    const { doing } = this;
    if (event.type === "pointercancel") return this.cancel();
    this.doing = null;
    doing?.end?.(this.from.moved);
    if (this.pointers.size)
      this.from.moved = true; // the finger that stays is no tap
    else if (this.from.kind === "touch") this.magnifier.hide();
  }

  cancel() {
    this.doing = null;
    this.store.cancel();
    this.magnifier.hide();
  }

  // --- what a press means, by what lies there and what is to be placed next

  #meant(x, y, kind) {
    const { store } = this;
    if (store.ended) return this.#pan();
    const hit = this.hit(x, y, kind);
    if (!hit && !store.current) return { ...this.#pan(), end: (moved) => moved || store.pick(null) };
    // who pulls at a mark is told why it stays
    if (!this.may(false)) return { ...this.#pan(), end: (moved) => (moved && !hit) || this.may(true) };
    if (hit) return this.#drag(hit, x, y, kind);
    return store.current.part === BOX ? this.#box(store.current, x, y) : this.#point(store.current, x, y, kind);
  }

  /** The mark at a place of the canvas: {slot, edges?}; null if there is none. */
  hit(x, y, kind) {
    const { store, stage } = this;
    const open = store.open();
    const reach = REACH[kind];
    if (store.selected?.part === BOX && store.value(store.selected)) {
      const near = handles(stage, store.value(store.selected))
        .map(([hx, hy, sx, sy]) => ({ away: Math.hypot(hx - x, hy - y), edges: [sx, sy] }))
        .sort((a, b) => a.away - b.away)[0];
      if (near.away <= reach + 2) return { slot: store.selected, edges: near.edges };
    }
    const points = store
      .slots()
      .filter((slot) => slot.part !== BOX && store.value(slot))
      .map((slot) => ({ slot, away: Math.hypot(...stage.place(...store.value(slot)).map((at, i) => at - [x, y][i])) }))
      .sort((a, b) => a.away - b.away);
    // what is to be placed may well be beside another one
    if (points.length && points[0].away <= (open && store.current.part !== BOX ? reach * 0.6 : reach)) return points[0];
    return this.#boxAt(x, y, kind, open);
  }

  #boxAt(x, y, kind, open) {
    const { store, stage } = this;
    // a finger that is to place something means no edge that happens to be near
    const reach = open ? (kind === "touch" ? 0 : 4) : REACH[kind] * 0.6;
    const boxes = store.slots().filter((slot) => slot.part === BOX && store.value(slot));
    const found = boxes.map((slot) => {
      const { x0, y0, x1, y1 } = edges(stage, store.value(slot));
      return { slot, within: Math.min(x - x0, x1 - x, y - y0, y1 - y), area: (x1 - x0) * (y1 - y0) };
    });
    const edge = found.find(({ within }) => Math.abs(within) <= reach);
    if (edge) return { slot: edge.slot };
    // the ground inside is free while something else is to be placed
    const meant = ({ slot, within }) => within > 0 && !open && (!store.current || same(store.current, slot));
    const [inmost] = found.filter(meant).sort((a, b) => a.area - b.area);
    if (inmost) return { slot: inmost.slot };
    return null;
  }

  #pan() {
    return { move: (x, y, dx, dy) => this.stage.panBy(dx, dy), end: () => {} };
  }

  #pinch() {
    const span = () => {
      const [a, b] = [...this.pointers.values()];
      return { away: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
    };
    let last = span();
    return {
      move: () => {
        const now = span();
        this.stage.panBy(now.x - last.x, now.y - last.y);
        if (last.away > 10 && now.away > 10) this.stage.zoomBy(now.away / last.away, now.x, now.y);
        last = now;
      },
    };
  }

  #drag({ slot, edges: moving }, x, y, kind) {
    const { store, stage } = this;
    const value = store.value(slot);
    const from = stage.spot(x, y);
    store.begin();
    const point = slot.part !== BOX;
    return {
      start: () => point && this.#magnify(value, kind, slot),
      move: (nx, ny) => {
        const [px, py] = stage.spot(nx, ny);
        const [dx, dy] = [px - from[0], py - from[1]];
        let now;
        if (point) now = inside(snapped([value[0] + dx, value[1] + dy], stage.view.scale), store.size);
        else if (moving) now = held(resized(value, moving, Math.round(dx), Math.round(dy)), store.size);
        else now = held([value[0] + Math.round(dx), value[1] + Math.round(dy), value[2], value[3]], store.size);
        store.drag(slot, now);
        if (point) this.#magnify(now, kind, slot);
      },
      end: () => {
        store.commit();
        if (!store.value(store.current)) {
          store.selected = slot; // and the next one stays next
          store.emit("draft");
        } else store.pick(slot);
        this.magnifier.hide(kind === "touch" ? 0 : 400);
      },
    };
  }

  #point(slot, x, y, kind) {
    const { store, stage } = this;
    const spot = (nx, ny) => inside(snapped(stage.spot(nx, ny), stage.view.scale), store.size);
    const outside = ([px, py]) => px < -0.5 || py < -0.5 || px > store.size[0] - 0.5 || py > store.size[1] - 0.5;
    if (outside(stage.spot(x, y))) return this.#pan();
    let at = spot(x, y);
    let other = null;
    store.begin();
    return {
      start: () => {
        store.selected = slot;
        store.drag(slot, at);
        this.#magnify(at, kind, slot);
      },
      move: (nx, ny) => {
        const { from } = this;
        const box = { target: slot.target, part: BOX };
        const boxed = store.mode === "pick" && store.group(slot.target).box !== "no";
        const lacking = boxed && !store.live?.draft.targets[slot.target]?.box;
        // a mouse that is dragged draws; a finger is led to its place
        if (!other && kind === "mouse" && lacking && Math.hypot(nx - from.x, ny - from.y) > DRAWN) {
          store.cancel();
          this.magnifier.hide();
          other = this.#box(box, from.x, from.y);
        }
        if (other) return other.move(nx, ny);
        at = spot(nx, ny);
        store.drag(slot, at);
        this.#magnify(at, kind, slot);
      },
      end: (moved) => {
        if (other) return other.end(moved);
        store.commit();
        store.advance(slot);
        if (kind === "mouse") this.#hover([x, y]);
      },
    };
  }

  #box(slot, x, y) {
    const { store, stage } = this;
    const from = stage.spot(x, y);
    let drawn = null;
    store.begin();
    return {
      move: (nx, ny) => {
        drawn = between(from, stage.spot(nx, ny), store.size);
        store.drag(slot, drawn);
      },
      end: () => {
        if (!drawn || Math.min(drawn[2], drawn[3]) < LEAST_BOX) {
          store.cancel();
          this.say(drawn ? `A box has at least ${LEAST_BOX} pixels to each side.` : "Drag across it to draw its box.");
          return;
        }
        store.commit();
        store.advance(slot);
      },
    };
  }

  // --- around it

  #magnify([x, y], kind, slot) {
    this.magnifier.show(x, y, kind, colour(this.store, slot.target));
  }

  #hover(at) {
    const { store, stage } = this;
    if (this.pointers.size) return;
    const hit = at && this.hit(...at, "mouse");
    if (!same(this.hovered, hit?.slot ?? null)) {
      this.hovered = hit?.slot ?? null;
      stage.draw();
    }
    const { current } = store;
    const open = store.open();
    const spot = at && !hit && open && open.part !== BOX && !store.ended && stage.spot(...at);
    const within = spot && spot.every((value, i) => value >= -0.5 && value <= store.size[i] - 0.5);
    if (within && this.may(false)) this.#magnify(snapped(spot, stage.view.scale), "mouse", open);
    else if (at || !this.magnifier.at || this.magnifier.at.by !== "keys") this.magnifier.hide();
    let cursor = "default";
    if (this.panning) cursor = "grab";
    else if (hit?.edges) cursor = cursorOf(hit.edges);
    else if (hit) cursor = "move";
    else if (current) cursor = "crosshair";
    else if (!stage.fitted) cursor = "grab";
    stage.canvas.style.cursor = cursor;
  }

  #wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? 100 : 1;
    const speed = event.ctrlKey ? 0.01 : 0.0016; // a pinch on a trackpad comes as small steps with Ctrl
    this.stage.zoomBy(Math.exp(-event.deltaY * lines * speed), ...this.#at(event));
  }
}

function cursorOf([sx, sy]) {
  if (!sx) return "ns-resize";
  if (!sy) return "ew-resize";
  return sx === sy ? "nwse-resize" : "nesw-resize";
}
