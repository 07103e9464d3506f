// How targets are drawn: in the colours of facetrack's videos, a diamond for a point of a start, a frame for a box.

import { readable } from "./dom.js";
import { markScale } from "./geometry.js";
import { BOX, sameSlot } from "./store.js";

/** Colours of facetrack's videos; vermilion is reserved for what is lost. */
const PALETTE = ["#50cdff", "#fae846", "#28e1a0", "#f096de", "#648cff", "#f0f0f0"];
export const LOST = "#ff6e19";
const RIM = "rgb(0 0 0 / 70%)";
export const LABEL_FONT = "600 12px system-ui, sans-serif";
export const LABEL_GROUND = "rgb(10 14 18 / 78%)";

/** The colour of a target; of a single one each part has its own, as in plots and videos. */
export const colour = (store, target, part = BOX) => {
  let index = store.layout.findIndex((one) => one.target === target);
  if (index === 0 && store.layout.length === 1) {
    const { points } = store.layout[0];
    index = points.includes(part) ? points.indexOf(part) : points.length;
  }
  return PALETTE[(index < 0 ? store.layout.length : index) % PALETTE.length];
};

/** A line with a dark rim, visible on any image. */
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

export function drawLabel(context, text, x, y, ink) {
  context.font = LABEL_FONT;
  context.textBaseline = "middle";
  const width = context.measureText(text).width;
  const left = Math.max(Math.min(x, context.canvas.clientWidth - width - 8), 8);
  const top = Math.max(y, 12);
  context.fillStyle = LABEL_GROUND;
  context.beginPath();
  context.roundRect(left - 5, top - 10, width + 10, 20, 5);
  context.fill();
  context.fillStyle = ink;
  context.fillText(text, left, top + 0.5);
}

/** A box's edges on the canvas: it covers the pixels l .. l + w - 1, to their outer edges. */
export function boxEdges(stage, [left, top, width, height]) {
  const [x0, y0] = stage.toCanvas(left - 0.5, top - 0.5);
  const [x1, y1] = stage.toCanvas(left + width - 0.5, top + height - 0.5);
  return { x0, y0, x1, y1 };
}

export function drawBox(context, stage, box, ink, width = 2, dash = []) {
  const { x0, y0, x1, y1 } = boxEdges(stage, box);
  context.beginPath();
  context.rect(x0, y0, x1 - x0, y1 - y0);
  stroke(context, ink, width, dash);
  return { x0, y0, y1 };
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
  const { x0, y0, x1, y1 } = boxEdges(stage, box);
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

/** The handles of a selected box. */
export function drawHandles(context, stage, box, ink) {
  for (const [x, y] of handles(stage, box)) {
    context.beginPath();
    context.rect(x - 5, y - 5, 10, 10);
    context.fillStyle = ink;
    stroke(context, "#fff", 1);
    context.fill();
  }
}

/** Around a selected point. */
export function ring(context, x, y, size = 1) {
  context.beginPath();
  context.arc(x, y, 15 * size, 0, 2 * Math.PI);
  stroke(context, "#fff", 1.5);
}

/** The name of a slot, with its target if there are several. */
export function label(store, { target, part }) {
  if (part === BOX) return readable(target);
  return store.layout.length > 1 ? `${readable(target)}: ${readable(part)}` : readable(part);
}

/** The marks of the draft: faint if they belong to another frame, filled if they correct a run. */
export function draftLayer(store, hovered) {
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
        const selected = sameSlot(store.selected, slot);
        const { x0, y0 } = drawBox(context, stage, given.box, ink, selected || fixes ? 2.5 : 2, dash);
        if (selected || store.layout.length > 1) drawLabel(context, label(store, slot), x0 + 5, y0 - 14, ink);
        if (selected && here) drawHandles(context, stage, given.box, ink);
      }
      const size = markScale(Object.values(given.points), stage.view.scale);
      for (const [part, at] of Object.entries(given.points)) {
        const slot = { target, part };
        const [x, y] = stage.toCanvas(...at);
        const selected = sameSlot(store.selected, slot);
        const own = colour(store, target, part);
        const width = size < 0.7 && !selected ? 1 : 2;
        diamond(context, x, y, (selected ? 8 : 6.5) * size, own, selected ? 2.5 * size : width, dash);
        context.fillStyle = own;
        if (fixes && here) context.fill();
        else context.fillRect(x - 1, y - 1, 2, 2);
        if (selected) ring(context, x, y, size);
        if (selected || sameSlot(hovered(), slot)) drawLabel(context, label(store, slot), x + 22, y - 16, own);
      }
    }
    context.globalAlpha = 1;
  };
}

/** The proposals of the frame, dashed; beside a draft only the one that is `previewed`. */
export function proposalLayer(store, previewed) {
  return (context, stage) => {
    if (!store.isHere() || store.ended) return;
    const all = store.isEmpty();
    const shown = all ? store.proposals : store.proposals.filter((one) => one === previewed());
    for (const proposal of shown) {
      for (const [target, given] of Object.entries(proposal.targets)) {
        const ink = all ? colour(store, target) : "#f0f0f0";
        if (given.box) {
          const { x0, y1 } = drawBox(context, stage, given.box, ink, 1.5, [6, 5]);
          if (all) drawLabel(context, proposal.label, x0 + 5, y1 + 14, ink);
        }
        for (const at of Object.values(given.points ?? {})) diamond(context, ...stage.toCanvas(...at), 4, ink, 1.5);
      }
    }
  };
}
