// Points and boxes, kept within the frame as the server requires it.

export const LEAST_BOX = 6; // pixels of a side, as on the server

export const clamp = (value, low, high) => Math.min(Math.max(value, low), Math.max(low, high));

/** A point within the frame. */
export const clampPoint = ([x, y], [width, height]) => [clamp(x, 0, width - 1), clamp(y, 0, height - 1)];

/** A box moved so that its centre is in the frame; its edges may be outside, as those of a face may. */
export function clampBox([left, top, w, h], [width, height]) {
  return [clamp(left, -(w - 1) / 2, width - 1 - (w - 1) / 2), clamp(top, -(h - 1) / 2, height - 1 - (h - 1) / 2), w, h];
}

export const centreOf = ([left, top, w, h]) => [left + (w - 1) / 2, top + (h - 1) / 2];

/** The box between two places, in whole pixels, both included, cut to the frame. */
export function boxBetween(a, b, size) {
  const [ax, ay] = clampPoint(a, size).map(Math.round);
  const [bx, by] = clampPoint(b, size).map(Math.round);
  return [Math.min(ax, bx), Math.min(ay, by), Math.abs(ax - bx) + 1, Math.abs(ay - by) + 1];
}

/** A box whose edges moved: `sx`, `sy` say which, -1 left or top, 1 right or bottom, 0 neither. */
export function resizeBox([left, top, w, h], [sx, sy], dx, dy, least = LEAST_BOX) {
  if (sx < 0) dx = Math.min(dx, w - least);
  if (sy < 0) dy = Math.min(dy, h - least);
  return [
    sx < 0 ? left + dx : left,
    sy < 0 ? top + dy : top,
    sx ? Math.max(w + sx * dx, Math.min(least, w)) : w,
    sy ? Math.max(h + sy * dy, Math.min(least, h)) : h,
  ];
}

/** [left, top, right, bottom] around points and boxes; null around nothing. */
export function around(places) {
  if (!places.length) return null;
  const corners = places.flatMap(([x, y, w = 1, h = 1]) => [
    [x, y],
    [x + w - 1, y + h - 1],
  ]);
  const [xs, ys] = [0, 1].map((k) => corners.map((corner) => corner[k]));
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

const ROOMY = 110; // CSS pixels across the points of a target, from which marks have their full size
const LEAST_MARK = 0.4;

/** By how much the marks of a target's points are smaller than others, 1 to 0.4: those of a small face would hide it. */
export function markScale(points, scale) {
  if (points.length < 2) return 1;
  const [left, top, right, bottom] = around(points);
  return clamp((Math.hypot(right - left, bottom - top) * scale) / ROOMY, LEAST_MARK, 1);
}

/** As fine as the eye can see: to a quarter of a pixel where pixels are large. */
export function snap([x, y], scale) {
  const step = scale >= 2 ? 0.25 : scale >= 1 ? 0.5 : 1;
  return [Math.round(x / step) * step, Math.round(y / step) * step];
}
