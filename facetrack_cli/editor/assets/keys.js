// The keyboard: one table of what every key does, which is also shown as help.

import { LONG_STEP } from "./actions.js";
import { $, make, say } from "./dom.js";

// as a key is called in the table: letters are small, Shift is told by the event
function nameOf(event) {
  const ctrl = event.ctrlKey || event.metaKey ? "Ctrl+" : "";
  if (event.key.startsWith("Arrow")) return "Arrow";
  if (!ctrl && !event.altKey && /^[1-9]$/.test(event.key)) return "digit";
  return `${ctrl}${event.altKey ? "Alt+" : ""}${event.key.length > 1 ? event.key : event.key.toLowerCase()}`;
}

/**
 * Groups [title, [in the help, text, names of keys, action(event)]] in the order of the help. Without names a line is of
 * the help alone, without a text of the keys alone. An action that returns false leaves the key to the browser.
 */
export function keyTable({ store, stage, clip, list, gestures, magnifier, mode, actions, undo, redo, zoom }) {
  const fixes = store.mode === "fix";
  const direction = (event) => (event.shiftKey ? -1 : 1);
  const remove = (event) => (fixes && event.shiftKey ? mode.discard() : actions.remove());
  const back = (event) => (event.shiftKey ? redo() : undo());
  const page = (event) => clip.by(event.key === "PageUp" ? -LONG_STEP : LONG_STEP);
  const end = (event) => store.show(store.bounds[event.key === "Home" ? "first" : "last"]);
  const pan = (event) => event.target === stage.canvas && (gestures.panning = true);
  const confirm = (event) => void mode.confirm(event.shiftKey);
  const focusNumber = () => $("frame-number").select() ?? $("frame-number").focus();
  const marks = [
    ["← ↑ ↓ →", "move the selected mark by 1 pixel", "Arrow", (event) => actions.arrow(event)],
    ["Shift or Alt and arrows", "by 10 pixels, or by a quarter of a pixel"],
    ["Ctrl and arrows", "move the right and bottom edges of a box"],
    ["[ and ]", "previous and next part", "[ ]", (event) => actions.step(event.key === "]" ? 1 : -1)],
    ["Delete", fixes ? "the selected part as it was tracked" : "remove the selected mark", "Delete Backspace", remove],
    ["Esc", "select nothing; stop drawing", "Escape", () => actions.escape()],
    ["M", "magnifier on or off", "m", () => say(`Magnifier ${magnifier.toggle() ? "on" : "off"}.`)],
  ];
  const review = [
    ["N", "next frame to review (Shift: previous)", "n", (event) => mode.review.next(direction(event))],
    ["W", "the worst frame that is not reviewed yet", "w", () => mode.review.worst()],
    ["C", "next correction (Shift: previous)", "c", (event) => mode.review.nextCorrection(direction(event))],
    ["K", "play or pause", "k", () => mode.play.toggle()],
    ["V", "hide or show the track", "v", () => mode.toggleShown()],
  ];
  const correct = [
    ["Enter", "in the list: choose the part; on the image: select the uncertain part", "Enter", () => actions.enter()],
    ["T or Ctrl+Enter", "track from here", "t Ctrl+Enter", () => void mode.track()],
    ["X", "the part is absent, or present (Shift: the whole target)", "x", (event) => mode.toggleAbsent(event.shiftKey)],
    ["Y", "it lies right, though it is called lost (Shift: in all frames around)", "y", confirm],
    ["E", "the two hands change their names from here on", "e", () => void mode.exchange()],
    ...marks,
    ["Shift+Delete", "discard what was moved"],
  ];
  const place = [
    ["Enter", "in the list: place the part in the middle; on the image: go to the next part", "Enter", () => actions.enter()],
    ...marks,
    ["1 … 9", "take what was found: face 1, face 2", "digit", (event) => mode.proposals.take(Number(event.key) - 1)],
    ["B", "begin here: the marks are of this frame", "b", () => mode.beginHere()],
  ];
  return [
    ...(fixes ? [["Review", review], ["Correct", correct]] : [["Marks", place]]),
    ["Clip", [
      ["← or →", `one frame, while no mark is selected (Shift: ${LONG_STEP})`],
      [", and .", "one frame back or forward, always", ", .", (event) => clip.by(event.key === "," ? -1 : 1)],
      ["Page_Up and Page_Down", `${LONG_STEP} frames back or forward`, "PageUp PageDown", page],
      ["Home and End", "first and last frame", "Home End", end],
      ["F", "type the number of a frame", "f", focusNumber],
      ["G", `go back to the frame of the ${fixes ? "moved parts" : "marks"}`, "g", () => store.showDraftFrame()],
    ]],
    ["View", [
      ["+ or −", "zoom; also the wheel, or two fingers", "+ =", () => zoom(1.25)],
      ["", "", "- −", () => zoom(0.8)],
      ["0", "the whole frame", "0", () => stage.toFit()],
      ["Z", "the targets, or the whole frame", "z", () => mode.showTargets()],
      ["Space and drag", "move the image; also the middle button, or two fingers", "Space", pan],
      ["L", "go to the list of parts", "l", () => (fixes ? mode.tabs.open(0) : list.focus())],
      ...(fixes ? [["D", "go to the list of frames to review", "d", () => mode.focusReview()]] : []),
      ["P", "go to the image", "p", () => stage.canvas.focus()],
      ["?", "this help", "?", () => !$("help").open && $("help").showModal()],
    ]],
    ["General", [
      ["Ctrl+Z", fixes ? "undo what was moved, then the last correction" : "undo", "Ctrl+z", back],
      ["Ctrl+Shift+Z", `redo${fixes ? " what was moved" : ""}; also Ctrl+Y`, "Ctrl+y", redo],
      ["Ctrl+S", "save", "Ctrl+s", () => void mode.save()],
    ]],
  ];
}

/** Listens to the keys of a table. */
export function listenToKeys(table) {
  const rows = table.flatMap(([, rows]) => rows);
  const does = new Map(rows.flatMap(([, , names = "", action]) => names.split(" ").map((name) => [name, action])));
  document.addEventListener("keydown", (event) => {
    const name = event.key === " " ? "Space" : nameOf(event);
    if (event.defaultPrevented || event.isComposing || !does.get(name)) return;
    const { target } = event;
    const typing = target.matches?.("input[type=text], input[type=number], textarea");
    const slider = target.matches?.("input[type=range]") && name === "Arrow";
    if ((typing || slider || document.querySelector("dialog[open]")) && name !== "Ctrl+s") return;
    if (does.get(name)(event) !== false) event.preventDefault();
  });
}

/** The table as elements of the help. */
export function keyHelp(table) {
  const shown = (word) => (["or", "and"].includes(word) ? ` ${word} ` : make("kbd", {}, word.replaceAll("_", " ")));
  return table.map(([title, rows]) => {
    const lines = rows.filter(([keys]) => keys);
    const terms = lines.flatMap(([keys, text]) => [make("dt", {}, ...keys.split(" ").map(shown)), make("dd", {}, text)]);
    return make("section", {}, make("h3", {}, title), make("dl", {}, ...terms));
  });
}
