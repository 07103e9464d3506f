// Mouse, finger and pen on the canvas: place, draw, move, resize; pan, pinch, wheel.

import { say } from "./dom.js";
import { boxEdges, colour, handles } from "./draw.js";
import { boxBetween, clampBox, clampPoint, LEAST_BOX, resizeBox, snap } from "./geometry.js";
import { BOX, sameSlot } from "./store.js";

const SLOP = { mouse: 3, touch: 8 }; // CSS pixels that are no movement yet
const REACH = { mouse: 9, touch: 22 }; // of a mark
const DRAWN = 8; // CSS pixels after which a press draws a box

/** `canEdit(explain)` says whether marks may be changed now, and tells the user if not. */
export class Gestures {
  constructor(stage, store, magnifier, canEdit) {
    Object.assign(this, { stage, store, magnifier, canEdit });
    this.pointers = new Map();
    this.gesture = null; // {start(), move(x, y, dx, dy), end(moved)}
    this.hovered = null; // the slot under the mouse
    this.panning = false; // while the space bar is down
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.#up(event));
    canvas.addEventListener("pointerleave", () => this.#hover(null));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  #position(event) {
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  #down(event) {
    const kind = event.pointerType === "mouse" ? "mouse" : "touch";
    if (kind === "mouse" && event.button > 1) return;
    event.preventDefault();
    this.stage.canvas.focus({ preventScroll: true });
    this.stage.canvas.setPointerCapture(event.pointerId);
    const [x, y] = this.#position(event);
    this.pointers.set(event.pointerId, { x, y });
    if (this.pointers.size > 1) {
      this.cancel(); // with a second finger, the first one did not mean to draw
      this.gesture = this.pointers.size === 2 ? this.#pinch() : null;
      return;
    }
    this.from = { x, y, kind, moved: false };
    this.gesture = event.button === 1 || this.panning ? this.#pan() : this.#gestureAt(x, y, kind);
    this.gesture.start?.();
  }

  #move(event) {
    const [x, y] = this.#position(event);
    const known = this.pointers.get(event.pointerId);
    if (!known) {
      if (event.pointerType === "mouse") this.#hover([x, y]);
      return;
    }
    const [dx, dy] = [x - known.x, y - known.y];
    Object.assign(known, { x, y });
    if (!this.gesture) return;
    if (this.pointers.size > 1) return this.gesture.move(x, y, dx, dy);
    const { from } = this;
    if (!from.moved && Math.hypot(x - from.x, y - from.y) <= SLOP[from.kind]) return;
    if (from.moved) return this.gesture.move(x, y, dx, dy);
    from.moved = true;
    this.gesture.move(x, y, x - from.x, y - from.y);
  }

  #up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    const { gesture } = this;
    if (event.type === "pointercancel") return this.cancel();
    this.gesture = null;
    gesture?.end?.(this.from.moved);
    if (this.pointers.size)
      this.from.moved = true; // the other finger does not tap
    else if (this.from.kind === "touch") this.magnifier.hide();
  }

  cancel() {
    this.gesture = null;
    this.store.cancel();
    this.magnifier.hide();
  }

  // --- the gesture of a press, by what is there and what is to be placed next

  #gestureAt(x, y, kind) {
    const { store } = this;
    if (store.ended) return this.#pan();
    const hit = this.hit(x, y, kind);
    if (!hit && !store.current) return { ...this.#pan(), end: (moved) => moved || store.select(null) };
    // a user who drags a mark is told why it stays
    if (!this.canEdit(false)) return { ...this.#pan(), end: (moved) => (moved && !hit) || this.canEdit(true) };
    if (hit) return this.#drag(hit, x, y, kind);
    return store.current.part === BOX ? this.#box(store.current, x, y) : this.#point(store.current, x, y, kind);
  }

  /** The mark at a place of the canvas: {slot, edges?}; null if there is none. */
  hit(x, y, kind) {
    const { store, stage } = this;
    const open = store.openSlot();
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
      .map((slot) => ({
        slot,
        away: Math.hypot(...stage.toCanvas(...store.value(slot)).map((at, i) => at - [x, y][i])),
      }))
      .sort((a, b) => a.away - b.away);
    // the next point may be close to another one
    if (points.length && points[0].away <= (open && store.current.part !== BOX ? reach * 0.6 : reach)) return points[0];
    return this.#boxAt(x, y, kind, open);
  }

  #boxAt(x, y, kind, open) {
    const { store, stage } = this;
    // a finger that places a part does not mean an edge nearby
    const reach = open ? (kind === "touch" ? 0 : 4) : REACH[kind] * 0.6;
    const boxes = store.slots().filter((slot) => slot.part === BOX && store.value(slot));
    const found = boxes.map((slot) => {
      const { x0, y0, x1, y1 } = boxEdges(stage, store.value(slot));
      return { slot, within: Math.min(x - x0, x1 - x, y - y0, y1 - y), area: (x1 - x0) * (y1 - y0) };
    });
    const edge = found.find(({ within }) => Math.abs(within) <= reach);
    if (edge) return { slot: edge.slot };
    // the inside of a box is no mark while something else is to be placed
    const hit = ({ slot, within }) => within > 0 && !open && (!store.current || sameSlot(store.current, slot));
    const [smallest] = found.filter(hit).sort((a, b) => a.area - b.area);
    return smallest ? { slot: smallest.slot } : null;
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
    const from = stage.toImage(x, y);
    store.begin();
    const point = slot.part !== BOX;
    return {
      start: () => point && this.#magnify(value, kind, slot),
      move: (nx, ny) => {
        const [px, py] = stage.toImage(nx, ny);
        const [dx, dy] = [px - from[0], py - from[1]];
        let now;
        if (point) now = clampPoint(snap([value[0] + dx, value[1] + dy], stage.view.scale), store.size);
        else if (moving) now = clampBox(resizeBox(value, moving, Math.round(dx), Math.round(dy)), store.size);
        else now = clampBox([value[0] + Math.round(dx), value[1] + Math.round(dy), value[2], value[3]], store.size);
        store.drag(slot, now);
        if (point) this.#magnify(now, kind, slot);
      },
      end: () => {
        store.commit();
        if (!store.value(store.current)) {
          store.selected = slot; // and the next missing one stays current
          store.emit("draft");
        } else store.select(slot);
        this.magnifier.hide(kind === "touch" ? 0 : 400);
      },
    };
  }

  #point(slot, x, y, kind) {
    const { store, stage } = this;
    const spot = (nx, ny) => clampPoint(snap(stage.toImage(nx, ny), stage.view.scale), store.size);
    const outside = ([px, py]) => px < -0.5 || py < -0.5 || px > store.size[0] - 0.5 || py > store.size[1] - 0.5;
    if (outside(stage.toImage(x, y))) return this.#pan();
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
        const missing = boxed && !store.beforeGesture?.draft.targets[slot.target]?.box;
        // a dragged mouse draws the missing box; a finger moves the point to its place
        if (!other && kind === "mouse" && missing && Math.hypot(nx - from.x, ny - from.y) > DRAWN) {
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
    const from = stage.toImage(x, y);
    let drawn = null;
    store.begin();
    return {
      move: (nx, ny) => {
        drawn = boxBetween(from, stage.toImage(nx, ny), store.size);
        store.drag(slot, drawn);
      },
      end: () => {
        if (!drawn || Math.min(drawn[2], drawn[3]) < LEAST_BOX) {
          store.cancel();
          say(drawn ? `A box has at least ${LEAST_BOX} pixels on each side.` : "Drag across it to draw its box.");
          return;
        }
        store.commit();
        store.advance(slot);
      },
    };
  }

  // --- magnifier, pointer and wheel

  #magnify([x, y], kind, slot) {
    this.magnifier.show(x, y, kind, colour(this.store, slot.target, slot.part));
  }

  #hover(at) {
    const { store, stage } = this;
    if (this.pointers.size) return;
    const hit = at && this.hit(...at, "mouse");
    if (!sameSlot(this.hovered, hit?.slot ?? null)) {
      this.hovered = hit?.slot ?? null;
      stage.draw();
    }
    const { current } = store;
    const open = store.openSlot();
    const spot = at && !hit && open && open.part !== BOX && !store.ended && stage.toImage(...at);
    const within = spot && spot.every((value, i) => value >= -0.5 && value <= store.size[i] - 0.5);
    if (within && this.canEdit(false)) this.#magnify(snap(spot, stage.view.scale), "mouse", open);
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
    const speed = event.ctrlKey ? 0.01 : 0.0016; // a pinch on a trackpad arrives as small steps with Ctrl
    this.stage.zoomBy(Math.exp(-event.deltaY * lines * speed), ...this.#position(event));
  }
}

function cursorOf([sx, sy]) {
  if (!sx) return "ns-resize";
  if (!sy) return "ew-resize";
  return sx === sy ? "nwse-resize" : "nesw-resize";
}
