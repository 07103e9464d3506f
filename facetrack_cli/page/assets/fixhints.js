// What is to be done next with a run that is put right, in words.

import { spoken } from "./dom.js";
import { DOUBT, words } from "./fixlist.js";
import { BOX } from "./store.js";

export const TOUCH = window.matchMedia("(pointer: coarse)");
export const count = (n, one, more = `${one}s`) => `${n} ${n === 1 ? one : more}`;

/** How a part is called in a sentence. */
export function called(store, { target, part }) {
  if (part === BOX) return spoken(target);
  return store.layout.length > 1 ? `${spoken(part)} of ${spoken(target)}` : spoken(part);
}

/** Whether what is told of any part of the frame passes a test. */
export function any(store, test) {
  return store.layout.some(({ target }) => store.parts(target).some((slot) => test(store.told(slot))));
}

/** Whether somebody should look at what is told of a part. */
export const poor = ({ kind, confidence }) => kind === "lost" || (confidence ?? 1) < DOUBT;

/** [title, text] for a frame, and for the part that is chosen in it, if any. */
export function hint(store, slot) {
  const frame = `Frame ${store.frame}`;
  if (store.ended) return ["Done", "This page has done its work; you may close it."];
  if (store.frame === store.bounds.first) {
    const next = TOUCH.matches ? "" : " N goes to the next doubtful one.";
    return ["The run begins here", `This frame cannot be corrected.${next}`];
  }
  if (store.busy) return [frame, "You may look around meanwhile."];
  if (store.current) return armed(store, store.current);
  if (slot) return chosen(store, slot);
  if (!store.isEmpty() && store.isHere()) {
    return [`${count(store.moved(), "part")} put right`, "If all is right in this frame now, track from here."];
  }
  const doubt = any(store, poor);
  return [frame, doubt ? "Drag what is wrong, or mark it as not there." : "Nothing is doubtful; drag what is wrong."];
}

function armed(store, slot) {
  if (store.around(slot)) {
    return [`All of ${spoken(slot.target)} anew`, "Draw its box; the points are placed in it by the picture."];
  }
  const press = TOUCH.matches ? "Tap where it is" : "Click where it is";
  const how = slot.part === BOX ? "Draw its box, from corner to corner" : press;
  const more = TOUCH.matches ? "" : "; Enter puts it in the middle";
  return [called(store, slot), store.value(slot) ? `${how}, or drag it.` : `${how}${more}.`];
}

function chosen(store, slot) {
  const told = words(store.told(slot));
  const how = TOUCH.matches ? "Drag it to its place." : "Drag it, or nudge it by the arrow keys. X: not there.";
  if (store.missing(slot)) {
    const again = TOUCH.matches ? "There again, if it is." : "X, if it is there again.";
    return [called(store, slot), `Absent from here on. ${again}`];
  }
  if (!told) return [called(store, slot), how];
  const sure = told.endsWith("%") ? " sure" : "";
  const said = told.replace("lost ", "lost, ");
  return [called(store, slot), `${said[0].toUpperCase()}${said.slice(1)}${sure}. ${how}`];
}
