// The run over the frame: boxes, and points with their windows and trails.
// The mark shows the status, as in facetrack's videos: a dot where tracked, a ring where hidden, a cross where lost, a diamond at a start.

import { colour, diamond, drawBox, drawHandles, drawLabel, label, LOST, ring, stroke } from "./draw.js";
import { CELL, placeOf } from "./fix_store.js";
import { percent } from "./dom.js";
import { centreOf, markScale } from "./geometry.js";
import { BOX, sameSlot } from "./store.js";

const TRAIL_S = 1; // of the past, and of the future
const SAMPLES = 40; // of a trail to each side
const FAINT = 0.4; // what was moved, and the other parts of its target

/** `shown()` says whether anything is drawn, `hovered()` which slot is under the pointer. */
export function trackLayer(store, rows, { shown, hovered }) {
  return (context, stage) => {
    const at = stage.image?.index;
    if (at === undefined || !shown() || !rows.frame(at)) return;
    const here = at === store.frame; // else an image on the way to it
    const slots = store.allParts();
    const faint = ({ target }) => here && store.isHere() && !!store.draft.targets[target];
    for (const slot of slots) {
      context.globalAlpha = faint(slot) ? FAINT : 1;
      drawTrail(context, stage, rows, slot, at, colour(store, slot.target, slot.part), store);
    }
    const sizes = new Map(store.layout.map(({ target }) => [target, sizeOf(store.parts(target), rows, at, stage)]));
    // what is lost is drawn on top
    const lost = (slot) => rows.cell(at, slot)?.[CELL.status] === "lost";
    for (const slot of [...slots.filter((slot) => !lost(slot)), ...slots.filter(lost)]) {
      const cell = rows.cell(at, slot);
      if (!placeOf(cell, slot.part)) continue;
      const chosen = here && (sameSlot(store.selected, slot) || sameSlot(store.highlighted, slot));
      const changed = here && (store.drafted(slot) || store.markedAbsent(slot));
      const titled = chosen || (here && sameSlot(hovered(), slot));
      context.globalAlpha = changed || (faint(slot) && !chosen) ? FAINT : 1;
      drawPart(context, stage, store, slot, cell, {
        chosen: chosen && !changed,
        titled: titled && !changed,
        size: sizes.get(slot.target),
      });
      if (changed) drawMove(context, stage, store, slot, cell);
    }
    context.globalAlpha = 1;
  };
}

// by how much the marks of a target's points are smaller
function sizeOf(slots, rows, at, stage) {
  const points = slots.filter(({ part }) => part !== BOX).map((slot) => placeOf(rows.cell(at, slot), slot.part));
  return markScale(points.filter(Boolean), stage.view.scale);
}

function drawPart(context, stage, store, slot, cell, { chosen, titled, size }) {
  const lost = cell[CELL.status] === "lost";
  const own = colour(store, slot.target, slot.part);
  const ink = lost ? LOST : own;
  const [x, y] = stage.toCanvas(cell[CELL.x], cell[CELL.y]);
  if (slot.part !== BOX) {
    const alpha = context.globalAlpha;
    context.globalAlpha = alpha * (chosen ? 0.75 : 0.35);
    // the window of the point, where those of all do not hide the face
    if (cell[CELL.w] && cell[CELL.h] && (chosen || size > 0.7)) drawBox(context, stage, placeOf(cell, BOX), ink, 1, lost ? [4, 4] : []);
    context.globalAlpha = alpha;
    drawStatus(context, x, y, cell, ink, (chosen ? 6.5 : 5) * size);
    if (chosen) ring(context, x, y, size);
    if (titled) drawLabel(context, title(store, slot, cell), x + 22, y - 16, ink);
    return;
  }
  const outline = cell[CELL.corners];
  const width = chosen ? 2.5 : 2;
  const dash = lost ? [8, 6] : [];
  if (outline) polygon(context, stage, outline, ink, width, dash);
  else drawBox(context, stage, placeOf(cell, BOX), ink, width, dash);
  drawStatus(context, x, y, cell, ink, 4);
  if (titled || store.layout.length > 1) {
    const [left, top] = labelPlace(stage, cell);
    drawLabel(context, titled ? title(store, slot, cell) : label(store, slot), left + 5, top - 14, ink);
  }
  if (!chosen || !sameSlot(store.selected, slot)) return;
  if (outline) drawBox(context, stage, placeOf(cell, BOX), own, 1, [3, 4]);
  drawHandles(context, stage, placeOf(cell, BOX), own);
}

function title(store, slot, cell) {
  const confidence = cell[CELL.confidence];
  return `${label(store, slot)}${confidence === null ? "" : ` ${percent(confidence)}`}`;
}

function drawStatus(context, x, y, cell, ink, size) {
  const status = cell[CELL.status];
  if (status === "lost") {
    context.beginPath();
    for (const turn of [-1, 1]) {
      context.moveTo(x - size, y - turn * size);
      context.lineTo(x + size, y + turn * size);
    }
    return stroke(context, ink, Math.min(2.5, size / 2));
  }
  context.fillStyle = ink;
  if (status === "init") {
    diamond(context, x, y, size * 1.3, ink, 2);
    if (cell[CELL.byHand]) context.fill();
    return;
  }
  context.beginPath();
  context.arc(x, y, size, 0, 2 * Math.PI);
  if (status === "hidden") return stroke(context, ink, Math.min(2.5, size / 2));
  context.lineWidth = size < 3.5 ? 1 : 2;
  context.strokeStyle = "rgb(0 0 0 / 70%)";
  context.stroke();
  context.fill();
}

function polygon(context, stage, corners, ink, width, dash) {
  context.beginPath();
  for (const corner of corners) context.lineTo(...stage.toCanvas(...corner));
  context.closePath();
  stroke(context, ink, width, dash);
}

// above the leftmost of the upper corners
function labelPlace(stage, cell) {
  const [x, y, w, h] = cell;
  const corners = (cell[CELL.corners] ?? [[x - w / 2, y - h / 2]]).map((corner) => stage.toCanvas(...corner));
  return [Math.min(...corners.map(([left]) => left)), Math.min(...corners.map(([, top]) => top))];
}

// a line from where it was tracked to where it was moved
function drawMove(context, stage, store, slot, cell) {
  const now = store.drafted(slot);
  if (!now) return;
  context.beginPath();
  context.moveTo(...stage.toCanvas(cell[CELL.x], cell[CELL.y]));
  context.lineTo(...stage.toCanvas(...(slot.part === BOX ? centreOf(now) : now)));
  context.globalAlpha = 0.8;
  stroke(context, "#fff", 1, [3, 4]);
}

function drawTrail(context, stage, rows, slot, at, ink, store) {
  const { first, last } = store.bounds;
  const reach = Math.max(Math.round(store.session.fps * TRAIL_S), 1);
  const step = Math.max(Math.ceil(reach / SAMPLES), 1);
  const alpha = context.globalAlpha;
  for (const sign of [-1, 1]) {
    let before = rows.cell(at, slot);
    for (let k = step; k <= reach; k += step) {
      const index = at + sign * k;
      const cell = index < first || index > last ? null : rows.cell(index, slot);
      // the track starts again at a correction, which is in the later one of the two
      const later = sign < 0 ? before : cell;
      if (!placeOf(cell, slot.part) || !placeOf(before, slot.part) || later?.[CELL.byHand]) break;
      context.beginPath();
      context.moveTo(...stage.toCanvas(before[CELL.x], before[CELL.y]));
      context.lineTo(...stage.toCanvas(cell[CELL.x], cell[CELL.y]));
      const lost = [before, cell].some((one) => one[CELL.status] === "lost");
      context.globalAlpha = alpha * (1 - k / (reach + step)) * (sign < 0 ? 0.95 : 0.6);
      context.lineWidth = sign < 0 ? 2 : 1.25;
      context.strokeStyle = lost ? LOST : ink;
      if (sign < 0 || k % (2 * step)) context.stroke(); // the future is dashed
      before = cell;
    }
  }
  context.globalAlpha = alpha;
}
