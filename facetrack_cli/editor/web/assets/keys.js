// What every key does, in the order of the help; what has nothing to show goes with the line above it.

import { FAR } from "./actions.js";
import { $, make } from "./dom.js";

const isArrow = (event) => event.key.startsWith("Arrow");
const either = (name) => plain(name, name.toUpperCase());
const way = (event) => (event.shiftKey ? -1 : 1);

/** `does` are undo, redo, save, help and zoom(factor). */
export function keytable({ store, stage, clip, list, gestures, magnifier, mode, deeds, does }) {
  const fixes = store.mode === "fix";
  const fix = (...keys) => (fixes ? keys : []);
  const pick = (...keys) => (fixes ? [] : keys);
  return [
    ...fix({
      title: "Where to look",
      keys: [
        {
          show: "N",
          does: "next doubtful frame (Shift: the one before)",
          test: either("n"),
          deed: (e) => mode.doubtful.next(way(e)),
        },
        {
          show: "W",
          does: "the worst frame that was not looked at",
          test: either("w"),
          deed: () => mode.doubtful.worst(),
        },
        {
          show: "C",
          does: "next correction (Shift: the one before)",
          test: either("c"),
          deed: (e) => mode.doubtful.nextCorrection(way(e)),
        },
        { show: "K", does: "play or pause", test: either("k"), deed: () => mode.play.toggle() },
        {
          show: "V",
          does: "hide or show the track, to see what lies below",
          test: either("v"),
          deed: () => mode.toggleShown(),
        },
      ],
    }),
    {
      title: fixes ? "Putting right" : "Marks",
      keys: [
        ...pick({
          show: "Enter",
          does: "in the list: choose the part, and put it in the middle; on the picture: on to the next",
          test: enter,
          deed: () => deeds.enter(),
        }),
        ...fix(
          {
            show: "Enter",
            does: "in the list: choose the part; on the picture: select the one that is doubtful",
            test: enter,
            deed: () => deeds.enter(),
          },
          { show: "T or Ctrl+Enter", does: "track from here", test: either("t"), deed: () => void mode.work.track() },
          { test: (e) => e.key === "Enter" && (e.ctrlKey || e.metaKey), deed: () => void mode.work.track() },
          {
            show: "X",
            does: "the part is not there, or there again (Shift: all of its target)",
            test: either("x"),
            deed: (e) => mode.toggleAbsent(e.shiftKey),
          },
        ),
        { show: "← ↑ ↓ →", does: "nudge the selected mark by 1 pixel", test: isArrow, deed: (e) => deeds.arrow(e) },
        { show: "Shift or Alt and arrows", does: "by 10 pixels, or by a quarter of one" },
        { show: "Ctrl and arrows", does: "move a box's right and bottom edges" },
        {
          show: "[ and ]",
          does: "previous and next part",
          test: plain("[", "]"),
          deed: (e) => deeds.step(e.key === "]" ? 1 : -1),
        },
        ...fix({
          show: "Shift+Delete",
          does: "throw away what was moved",
          test: (e) => plain("Delete")(e) && e.shiftKey,
          deed: () => mode.throwAway(),
        }),
        {
          show: "Delete",
          does: fixes ? "the selected part back to where it was tracked" : "remove the selected mark",
          test: plain("Delete", "Backspace"),
          deed: () => deeds.remove(),
        },
        {
          show: "Esc",
          does: "select nothing; end what is being drawn",
          test: plain("Escape"),
          deed: () => deeds.escape(),
        },
        {
          show: "1 … 9",
          does: "take what was found: face 1, face 2",
          test: (e) => plain(e.key)(e) && /^[1-9]$/.test(e.key),
          deed: (e) => mode.take(Number(e.key) - 1),
        },
        {
          show: "M",
          does: "magnifier on or off",
          test: either("m"),
          deed: () => does.say(`Magnifier ${magnifier.toggle() ? "on" : "off"}.`),
        },
      ],
    },
    {
      title: "Clip",
      keys: [
        { show: "← or →", does: "one frame, while no mark is selected (Shift: 25)" },
        {
          show: ", and .",
          does: "one frame back or on, always",
          test: plain(",", "."),
          deed: (e) => clip.by(e.key === "," ? -1 : 1),
        },
        {
          show: "Page_Up and Page_Down",
          does: `${FAR} frames back or on`,
          test: plain("PageUp", "PageDown"),
          deed: (e) => clip.by(e.key === "PageUp" ? -FAR : FAR),
        },
        {
          show: "Home and End",
          does: "first and last frame",
          test: plain("Home", "End"),
          deed: (e) => store.show(e.key === "Home" ? store.bounds.first : store.bounds.last),
        },
        {
          show: "F",
          does: "type the number of a frame",
          test: either("f"),
          deed: () => $("frame-number").select() ?? $("frame-number").focus(),
        },
        {
          show: "G",
          does: `back to the frame of ${fixes ? "what was moved" : "the marks"}`,
          test: either("g"),
          deed: () => mode.goBack(),
        },
        ...pick({
          show: "B",
          does: "begin here: the marks are of this frame",
          test: either("b"),
          deed: () => mode.beginHere(),
        }),
      ],
    },
    {
      title: "View",
      keys: [
        { show: "+ or −", does: "zoom; the wheel, or two fingers, too", test: plain("+", "="), deed: does.zoom(1.25) },
        { test: plain("-", "−"), deed: does.zoom(0.8) },
        { show: "0", does: "the whole picture", test: plain("0"), deed: () => stage.toFit() },
        {
          show: "Space and drag",
          does: "move the picture; the middle button, or two fingers, too",
          test: (e) => e.key === " " && e.target === stage.canvas,
          deed: () => (gestures.panning = true),
        },
        { show: "L", does: "to the list of parts", test: either("l"), deed: () => mode.list?.() ?? list.focus() },
        ...fix({ show: "D", does: "to the list of doubtful frames", test: either("d"), deed: () => mode.toDoubtful() }),
        { show: "P", does: "to the picture", test: either("p"), deed: () => stage.canvas.focus() },
        { show: "?", does: "this help", test: plain("?"), deed: does.help },
      ],
    },
    {
      title: "All of it",
      keys: [
        {
          show: "Ctrl+Z",
          does: fixes ? "undo what was moved, then the last correction" : "undo",
          test: ctrl("z"),
          deed: does.undo,
        },
        {
          show: "Ctrl+Shift+Z",
          does: `redo (Ctrl+Y too)${fixes ? " what was moved" : ""}`,
          test: (e) => ctrl("z", true)(e) || ctrl("y")(e),
          deed: does.redo,
        },
        { show: "Ctrl+S", does: "save", test: ctrl("s"), deed: does.save, always: true },
      ],
    },
  ];
}

const enter = (event) => event.key === "Enter" && !event.ctrlKey && !event.metaKey;

// The keyboard: one table, which is also what the help shows.

/** Groups of {show, does, test(event), deed(event)}; a deed that gives back false leaves the key to the browser. */
export class Keys {
  constructor(table) {
    this.table = table.flatMap(({ keys }) => keys);
    this.groups = table;
    document.addEventListener("keydown", (event) => this.#down(event));
  }

  #down(event) {
    if (event.defaultPrevented || event.isComposing) return;
    const { target } = event;
    const writing = target.matches?.("input[type=text], input[type=number], textarea");
    const own = target.matches?.("input[type=range]") && event.key.startsWith("Arrow");
    const open = document.querySelector("dialog[open]");
    for (const key of this.table) {
      if (!key.test || !key.test(event)) continue;
      if ((writing || own || open) && !key.always) return;
      if (key.deed(event) === false) continue;
      event.preventDefault();
      return;
    }
  }

  /** The table for the help. */
  help() {
    return this.groups.map(({ title, keys }) => {
      const rows = keys
        .filter(({ show }) => show)
        .flatMap(({ show, does }) => [
          make(
            "dt",
            {},
            ...show
              .split(" ")
              .map((word) =>
                word === "or" || word === "and" ? ` ${word} ` : make("kbd", {}, word.replaceAll("_", " ")),
              ),
          ),
          make("dd", {}, does),
        ]);
      return make("section", {}, make("h3", {}, title), make("dl", {}, ...rows));
    });
  }
}

export const plain =
  (...names) =>
  (event) =>
    !event.ctrlKey && !event.metaKey && !event.altKey && names.includes(event.key);
export const ctrl =
  (name, shift = false) =>
  (event) =>
    (event.ctrlKey || event.metaKey) && !event.altKey && event.shiftKey === shift && event.key.toLowerCase() === name;
