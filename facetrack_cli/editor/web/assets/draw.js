// How targets look: the colours of facetrack's videos, a diamond for a point where a track begins, a frame for a box.

import { BOX, same } from "./store.js";

/** PALETTE of video/marks.py; vermilion is kept for what is lost. */
export const PALETTE = ["#50cdff", "#fae846", "#28e1a0", "#f096de", "#f0f0f0", "#648cff"];
export const LOST = "#ff6e19";
const RIM = "rgb(0 0 0 / 70%)";
const FONT = "600 12px system-ui, sans-serif";

export const colour = (store, target) => {
  const index = store.layout.findIndex((one) => one.target === target);
  return PALETTE[(index < 0 ? store.layout.length : index) % PALETTE.length];
};

/** A line with a dark rim, which is seen on any picture. */
export function stroke(context, ink, width, dash = []) {
  context.lineJoin = "round";
  context.setLineDash([]);
  context.lineWidth = width + 2;
  context.strokeStyle = RIM;
  if (dash.length) context.globalAlpha *= 0.6;
  context.stroke();
  if (dash.length) context.globalAlpha /= 0.6;
  context.setLineDash(dash);
  context.lineWidth = width;
  context.strokeStyle = ink;
  context.stroke();
  context.setLineDash([]);
}

export function text(context, words, x, y, ink) {
  context.font = FONT;
  context.textBaseline = "middle";
  const width = context.measureText(words).width;
  const room = context.canvas.clientWidth;
  const left = Math.max(Math.min(x, room - width - 8), 8);
  const top = Math.max(y, 12);
  context.fillStyle = "rgb(10 14 18 / 78%)";
  context.beginPath();
  context.roundRect(left - 5, top - 10, width + 10, 20, 5);
  context.fill();
  context.fillStyle = ink;
  context.fillText(words, left, top + 0.5);
}

/** A box's corners on the canvas: it covers the pixels l .. l + w - 1, to their outer edges. */
export function edges(stage, [left, top, width, height]) {
  const [x0, y0] = stage.place(left - 0.5, top - 0.5);
  const [x1, y1] = stage.place(left + width - 0.5, top + height - 0.5);
  return { x0, y0, x1, y1 };
}

export function frame(context, stage, box, ink, width = 2, dash = []) {
  const { x0, y0, x1, y1 } = edges(stage, box);
  context.beginPath();
  context.rect(x0, y0, x1 - x0, y1 - y0);
  stroke(context, ink, width, dash);
  return { x0, y0, x1, y1 };
}

/** The path of a diamond, to be filled or stroked. */
export function diamondPath(context, x, y, size) {
  context.beginPath();
  context.moveTo(x - size, y);
  context.lineTo(x, y - size);
  context.lineTo(x + size, y);
  context.lineTo(x, y + size);
  context.closePath();
}

export function diamond(context, x, y, size, ink, width = 2, dash = []) {
  diamondPath(context, x, y, size);
  stroke(context, ink, width, dash);
}

/** The eight handles of a box: where they are, and which edges each moves (-1 left or top, 1 right or bottom). */
export function handles(stage, box) {
  const { x0, y0, x1, y1 } = edges(stage, box);
  const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
  const all = [
    [x0, y0, -1, -1],
    [x1, y0, 1, -1],
    [x0, y1, -1, 1],
    [x1, y1, 1, 1],
  ];
  if (x1 - x0 > 60) all.push([x, y0, 0, -1], [x, y1, 0, 1]);
  if (y1 - y0 > 60) all.push([x0, y, -1, 0], [x1, y, 1, 0]);
  return all;
}

/** What a selected box is resized by. */
export function grips(context, stage, box, ink) {
  for (const [x, y] of handles(stage, box)) {
    context.beginPath();
    context.rect(x - 5, y - 5, 10, 10);
    context.fillStyle = ink;
    stroke(context, "#fff", 1);
    context.fill();
  }
}

/** Around a selected point. */
export function ring(context, x, y) {
  context.beginPath();
  context.arc(x, y, 15, 0, 2 * Math.PI);
  stroke(context, "#fff", 1.5);
}

/** How a part is called on the picture. */
export function label(store, { target, part }) {
  if (part === BOX) return target;
  return store.layout.length > 1 ? `${target}: ${part}` : part;
}

/** The draft's own marks; faint where they belong to another frame, filled where they put a run right. */
export function marks(store, hovered) {
  return (context, stage) => {
    const here = store.isHere();
    const dash = here ? [] : [4, 4];
    const fixes = store.mode === "fix";
    context.globalAlpha = here ? 1 : 0.55;
    for (const { target } of store.layout) {
      const given = store.draft.targets[target];
      if (!given) continue;
      const ink = colour(store, target);
      if (given.box) {
        const slot = { target, part: BOX };
        const chosen = same(store.selected, slot);
        const { x0, y0 } = frame(context, stage, given.box, ink, chosen || fixes ? 2.5 : 2, dash);
        if (chosen || store.layout.length > 1) text(context, label(store, slot), x0 + 5, y0 - 14, ink);
        if (chosen && here) grips(context, stage, given.box, ink);
      }
      for (const [part, [px, py]] of Object.entries(given.points)) {
        const slot = { target, part };
        const [x, y] = stage.place(px, py);
        const chosen = same(store.selected, slot);
        diamond(context, x, y, chosen ? 8 : 6.5, ink, chosen ? 2.5 : 2, dash);
        context.fillStyle = ink;
        if (fixes && here) context.fill();
        else context.fillRect(x - 1, y - 1, 2, 2);
        if (chosen) ring(context, x, y);
        if (chosen || same(hovered(), slot)) text(context, label(store, slot), x + 22, y - 16, ink);
      }
    }
    context.globalAlpha = 1;
  };
}

/** What was proposed for this frame, dashed; beside a draft, or a track, only the one that is looked at. */
export function proposed(store, looked) {
  return (context, stage) => {
    if (!store.isHere() || store.ended) return;
    const all = store.mode === "pick" && store.isEmpty();
    const shown = all ? store.proposals : store.proposals.filter((one) => one === looked());
    for (const { targets } of shown) {
      for (const [target, given] of Object.entries(targets)) {
        const ink = all ? colour(store, target) : "#f0f0f0";
        if (given.box) frame(context, stage, given.box, ink, 1.5, [6, 5]);
        for (const [x, y] of Object.values(given.points ?? {})) diamond(context, ...stage.place(x, y), 4, ink, 1.5);
      }
    }
  };
}
