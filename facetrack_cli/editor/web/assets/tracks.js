// The run over the frame: boxes, points with their windows, and where they came from and go to.

import { colour, diamond, frame, grips, label, LOST, ring, stroke, text } from "./draw.js";
import { CELL, placeOf } from "./fix_store.js";
import { BOX, same } from "./store.js";

// Status by form, as in facetrack's videos: a dot where tracked, a cross where lost, a diamond where it began.


const TRAIL_S = 1; // of the past, and of what comes
const SAMPLES = 40; // of a trail to each side
const FAINT = 0.4; // what is put right, and what goes with it

/** `shown()` says whether anything is drawn, `hovered()` which part is pointed at. */
export function tracks(store, rows, { shown, hovered }) {
  return (context, stage) => {
    const at = stage.picture?.index;
    if (at === undefined || !shown() || !rows.frame(at)) return;
    const here = at === store.frame; // else a picture on the way to it
    const slots = store.layout.flatMap(({ target }) => store.parts(target));
    const faint = ({ target }) => here && store.isHere() && !!store.draft.targets[target];
    for (const slot of slots) {
      context.globalAlpha = faint(slot) ? FAINT : 1;
      trail(context, stage, rows, slot, at, colour(store, slot.target), store);
    }
    // what is lost lies on top
    const lost = (slot) => rows.cell(at, slot)?.[CELL.status] === "lost";
    for (const slot of [...slots.filter((slot) => !lost(slot)), ...slots.filter(lost)]) {
      const cell = rows.cell(at, slot);
      if (!placeOf(cell, slot.part)) continue;
      const chosen = here && (same(store.selected, slot) || same(store.looked, slot));
      const moved = here && (store.drafted(slot) || store.gone(slot));
      const titled = chosen || (here && same(hovered(), slot));
      context.globalAlpha = faint(slot) && !chosen ? FAINT : 1;
      if (moved) context.globalAlpha = FAINT;
      mark(context, stage, store, slot, cell, { chosen: chosen && !moved, titled: titled && !moved });
      if (moved) from(context, stage, store, slot, cell);
    }
    context.globalAlpha = 1;
  };
}

function mark(context, stage, store, slot, cell, { chosen, titled }) {
  const lost = cell[CELL.status] === "lost";
  const own = colour(store, slot.target);
  const ink = lost ? LOST : own;
  const [x, y] = stage.place(cell[CELL.x], cell[CELL.y]);
  const selected = chosen && same(store.selected, slot);
  if (slot.part !== BOX) {
    const faint = context.globalAlpha;
    context.globalAlpha = faint * (chosen ? 0.75 : 0.35);
    pane(context, stage, cell, ink, lost);
    context.globalAlpha = faint;
    sign(context, x, y, cell, ink, chosen ? 6.5 : 5);
    if (chosen) ring(context, x, y);
    if (titled) text(context, named(store, slot, cell), x + 22, y - 16, ink);
    return;
  }
  const outline = cell[CELL.corners];
  if (outline) polygon(context, stage, outline, ink, chosen ? 2.5 : 2, lost ? [8, 6] : []);
  else frame(context, stage, placeOf(cell, BOX), ink, chosen ? 2.5 : 2, lost ? [8, 6] : []);
  sign(context, x, y, cell, ink, 4);
  const [left, top] = corner(stage, cell);
  if (titled || store.layout.length > 1) {
    text(context, titled ? named(store, slot, cell) : label(store, slot), left + 5, top - 14, ink);
  }
  if (!selected) return;
  if (outline) frame(context, stage, placeOf(cell, BOX), own, 1, [3, 4]);
  grips(context, stage, placeOf(cell, BOX), own);
}

function named(store, slot, cell) {
  const sure = cell[CELL.confidence];
  return `${label(store, slot)}${sure === null ? "" : ` ${Math.round(sure * 100)} %`}`;
}

function sign(context, x, y, cell, ink, size) {
  const status = cell[CELL.status];
  if (status === "lost") {
    context.beginPath();
    for (const turn of [-1, 1]) {
      context.moveTo(x - size, y - turn * size);
      context.lineTo(x + size, y + turn * size);
    }
    return stroke(context, ink, 2.5);
  }
  if (status === "init") {
    diamond(context, x, y, size * 1.3, ink, 2);
    context.fillStyle = ink;
    if (cell[CELL.byHand]) context.fill();
    return;
  }
  context.beginPath();
  context.arc(x, y, size, 0, 2 * Math.PI);
  context.lineWidth = 2;
  context.strokeStyle = "rgb(0 0 0 / 70%)";
  context.stroke();
  context.fillStyle = ink;
  context.fill();
}

function pane(context, stage, cell, ink, lost) {
  const [x, y, w, h] = cell;
  if (!w || !h) return;
  frame(context, stage, [x - (w - 1) / 2, y - (h - 1) / 2, w, h], ink, 1, lost ? [4, 4] : []);
}

function polygon(context, stage, corners, ink, width, dash) {
  context.beginPath();
  for (const [x, y] of corners) context.lineTo(...stage.place(x, y));
  context.closePath();
  stroke(context, ink, width, dash);
}

// where a name goes: above the leftmost of the upper corners
function corner(stage, cell) {
  const [x, y, w, h] = cell;
  const places = cell[CELL.corners] ?? [[x - w / 2, y - h / 2]];
  const all = places.map((place) => stage.place(...place));
  return [Math.min(...all.map(([left]) => left)), Math.min(...all.map(([, top]) => top))];
}

// a line from where it was tracked to where it was put
function from(context, stage, store, slot, cell) {
  const now = store.drafted(slot);
  if (!now) return;
  const [x, y, w, h] = now;
  context.beginPath();
  context.moveTo(...stage.place(cell[CELL.x], cell[CELL.y]));
  context.lineTo(...stage.place(...(slot.part === BOX ? [x + (w - 1) / 2, y + (h - 1) / 2] : [x, y])));
  context.globalAlpha = 0.8;
  stroke(context, "#fff", 1, [3, 4]);
}

function trail(context, stage, rows, slot, at, ink, store) {
  const { first, last } = store.bounds;
  const reach = Math.max(Math.round(store.session.fps * TRAIL_S), 1);
  const step = Math.max(Math.ceil(reach / SAMPLES), 1);
  const alpha = context.globalAlpha;
  for (const sign of [-1, 1]) {
    let before = rows.cell(at, slot);
    for (let k = step; k <= reach; k += step) {
      const index = at + sign * k;
      // the later of two is where a correction begins anew
      const later = sign < 0 ? before : rows.cell(index, slot);
      const cell = index < first || index > last ? null : rows.cell(index, slot);
      if (!placeOf(cell, slot.part) || !placeOf(before, slot.part) || later?.[CELL.byHand]) break;
      context.beginPath();
      context.moveTo(...stage.place(before[CELL.x], before[CELL.y]));
      context.lineTo(...stage.place(cell[CELL.x], cell[CELL.y]));
      const lost = [before, cell].some((one) => one[CELL.status] === "lost");
      context.globalAlpha = alpha * (1 - k / (reach + step)) * (sign < 0 ? 0.95 : 0.6);
      context.lineWidth = sign < 0 ? 2 : 1.25;
      context.strokeStyle = lost ? LOST : ink;
      if (sign < 0 || k % (2 * step)) context.stroke(); // what comes is dashed
      before = cell;
    }
  }
  context.globalAlpha = alpha;
}
