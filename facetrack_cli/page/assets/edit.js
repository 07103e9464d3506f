// What can be done to a part: put it somewhere, nudge, resize, remove. Within the picture, as the server will ask.

import { BOX, LEAST_BOX } from "./store.js";

const clamp = (value, low, high) => Math.min(Math.max(value, low), Math.max(low, high));

/** A point on a pixel of the picture. */
export const inside = ([x, y], [width, height]) => [clamp(x, 0, width - 1), clamp(y, 0, height - 1)];

/** A box moved so that its centre is in the picture; its edges may stand out, as a face may. */
export function held([left, top, w, h], [width, height]) {
  return [clamp(left, -(w - 1) / 2, width - 1 - (w - 1) / 2), clamp(top, -(h - 1) / 2, height - 1 - (h - 1) / 2), w, h];
}

/** The box between two places, in whole pixels, both of them in it, cut to the picture. */
export function between(a, b, size) {
  const [ax, ay] = inside(a, size).map(Math.round);
  const [bx, by] = inside(b, size).map(Math.round);
  return [Math.min(ax, bx), Math.min(ay, by), Math.abs(ax - bx) + 1, Math.abs(ay - by) + 1];
}

/** A box whose edges moved: `sx`, `sy` say which, -1 left or top, 1 right or bottom, 0 neither. */
export function resized([left, top, w, h], [sx, sy], dx, dy, least = LEAST_BOX) {
  if (sx < 0) dx = Math.min(dx, w - least);
  if (sy < 0) dy = Math.min(dy, h - least);
  return [
    sx < 0 ? left + dx : left,
    sy < 0 ? top + dy : top,
    sx ? Math.max(w + sx * dx, Math.min(least, w)) : w,
    sy ? Math.max(h + sy * dy, Math.min(least, h)) : h,
  ];
}

/** As fine as can be seen: a quarter of a pixel where pixels are large. */
export function snapped([x, y], scale) {
  const step = scale >= 2 ? 0.25 : scale >= 1 ? 0.5 : 1;
  return [Math.round(x / step) * step, Math.round(y / step) * step];
}

/** Where a part is put by the keyboard: in the middle of its target's box, or of what is seen of the picture. */
export function middle(store, stage, slot) {
  const { width, height } = stage.box;
  const seen = inside(stage.spot(width / 2, height / 2), store.size).map(Math.round);
  if (slot.part !== BOX) {
    const box = store.draft.targets[slot.target]?.box;
    return box ? inside([box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2], store.size) : seen;
  }
  const side = Math.max(
    Math.round(Math.min(...store.size, width / stage.view.scale, height / stage.view.scale) / 3),
    8,
  );
  return [seen[0] - (side >> 1), seen[1] - (side >> 1), side, side];
}

/** Moves what is selected by (dx, dy) pixels; nudges of the same mark are one step of undo. */
export function nudge(store, dx, dy) {
  const slot = store.selected;
  const value = store.value(slot);
  if (!value) return false;
  const [x, y, ...rest] = value;
  const moved = rest.length ? held([x + dx, y + dy, ...rest], store.size) : inside([x + dx, y + dy], store.size);
  store.set(slot, moved, `nudge ${slot.target} ${slot.part}`);
  return true;
}

/** Moves the right and the bottom edge of the selected box. */
export function stretch(store, dx, dy) {
  const slot = store.selected;
  const value = slot?.part === BOX && store.value(slot);
  if (!value) return false;
  store.set(slot, held(resized(value, [1, 1], dx, dy), store.size), `stretch ${slot.target}`);
  return true;
}

export function remove(store, slot) {
  if (!store.value(slot)) return false;
  store.set(slot, null);
  store.current = slot;
  store.selected = null;
  store.emit("draft");
  return true;
}
