// The keyboard: one table of what every key does, which is also shown as help.

import { LONG_STEP } from "./actions.js";
import { $, make } from "./dom.js";

const key = (show, text, test, action, always = false) => ({ show, text, test, action, always });

// tests of an event
const plain =
  (...names) =>
  (event) =>
    !event.ctrlKey && !event.metaKey && !event.altKey && names.includes(event.key);
const letter = (name) => plain(name, name.toUpperCase());
const ctrl =
  (name, shift = false) =>
  (event) =>
    (event.ctrlKey || event.metaKey) && !event.altKey && event.shiftKey === shift && event.key.toLowerCase() === name;
const arrow = (event) => event.key.startsWith("Arrow");
const digit = (event) => plain(event.key)(event) && /^[1-9]$/.test(event.key);
const enter = (event) => event.key === "Enter" && !event.ctrlKey && !event.metaKey;
const ctrlEnter = (event) => event.key === "Enter" && (event.ctrlKey || event.metaKey);
const redo = (event) => ctrl("z", true)(event) || ctrl("y")(event);

/**
 * Groups {title, keys} in the order of the help. A key without `show` is not in the help, one without `test` belongs to
 * the line above it. An action that returns false leaves the key to the browser. `does` are undo, redo, save, help and
 * zoom(factor).
 */
export function keyTable({ store, stage, clip, list, gestures, magnifier, mode, actions, does, say }) {
  const direction = (event) => (event.shiftKey ? -1 : 1);
  const toFrameNumber = () => $("frame-number").select() ?? $("frame-number").focus();
  const toggleMagnifier = () => say(`Magnifier ${magnifier.toggle() ? "on" : "off"}.`);
  const take = (event) => mode.proposals.take(Number(event.key) - 1);
  const moving = [
    key("← ↑ ↓ →", "move the selected mark by 1 pixel", arrow, (event) => actions.arrow(event)),
    key("Shift or Alt and arrows", "by 10 pixels, or by a quarter of a pixel"),
    key("Ctrl and arrows", "move the right and bottom edges of a box"),
    key("[ and ]", "previous and next part", plain("[", "]"), (event) => actions.step(event.key === "]" ? 1 : -1)),
  ];
  const marks = [
    key("Esc", "select nothing; stop drawing", plain("Escape"), () => actions.escape()),
    key("1 … 9", "take what was found: face 1, face 2", digit, take),
    key("M", "magnifier on or off", letter("m"), toggleMagnifier),
  ];
  const remove = (text) => key("Delete", text, plain("Delete", "Backspace"), () => actions.remove());
  const review = {
    title: "Review",
    keys: [
      key("N", "next frame to review (Shift: previous)", letter("n"), (event) => mode.review.next(direction(event))),
      key("W", "the worst frame that is not reviewed yet", letter("w"), () => mode.review.worst()),
      key("C", "next correction (Shift: previous)", letter("c"), (event) =>
        mode.review.nextCorrection(direction(event)),
      ),
      key("K", "play or pause", letter("k"), () => mode.play.toggle()),
      key("V", "hide or show the track", letter("v"), () => mode.toggleShown()),
    ],
  };
  const correcting = {
    title: "Correct",
    keys: [
      key("Enter", "in the list: choose the part; on the image: select the uncertain part", enter, () =>
        actions.enter(),
      ),
      key("T or Ctrl+Enter", "track from here", letter("t"), () => void mode.jobs.track()),
      key("", "", ctrlEnter, () => void mode.jobs.track()),
      key("X", "the part is absent, or present (Shift: the whole target)", letter("x"), (event) =>
        mode.toggleAbsent(event.shiftKey),
      ),
      key("Y", "it lies right, though it is called lost (Shift: in all frames around)", letter("y"), (event) =>
        mode.confirm(event.shiftKey),
      ),
      key("E", "the two hands change their names from here on", letter("e"), () =>
        void mode.jobs.exchange(store.frame),
      ),
      ...moving,
      key(
        "Shift+Delete",
        "discard what was moved",
        (event) => plain("Delete")(event) && event.shiftKey,
        () => mode.discard(),
      ),
      remove("the selected part as it was tracked"),
      ...marks,
    ],
  };
  const placing = {
    title: "Marks",
    keys: [
      key("Enter", "in the list: place the part in the middle; on the image: go to the next part", enter, () =>
        actions.enter(),
      ),
      ...moving,
      remove("remove the selected mark"),
      ...marks,
    ],
  };
  const fixes = store.mode === "fix";
  return [
    ...(fixes ? [review, correcting] : [placing]),
    {
      title: "Clip",
      keys: [
        key("← or →", `one frame, while no mark is selected (Shift: ${LONG_STEP})`),
        key(", and .", "one frame back or forward, always", plain(",", "."), (event) =>
          clip.by(event.key === "," ? -1 : 1),
        ),
        key("Page_Up and Page_Down", `${LONG_STEP} frames back or forward`, plain("PageUp", "PageDown"), (event) =>
          clip.by(event.key === "PageUp" ? -LONG_STEP : LONG_STEP),
        ),
        key("Home and End", "first and last frame", plain("Home", "End"), (event) =>
          store.show(event.key === "Home" ? store.bounds.first : store.bounds.last),
        ),
        key("F", "type the number of a frame", letter("f"), toFrameNumber),
        key("G", `go back to the frame of the ${fixes ? "moved parts" : "marks"}`, letter("g"), () =>
          store.showDraftFrame(),
        ),
        ...(fixes ? [] : [key("B", "begin here: the marks are of this frame", letter("b"), () => mode.beginHere())]),
      ],
    },
    {
      title: "View",
      keys: [
        key("+ or −", "zoom; also the wheel, or two fingers", plain("+", "="), does.zoom(1.25)),
        key("", "", plain("-", "−"), does.zoom(0.8)),
        key("0", "the whole frame", plain("0"), () => stage.toFit()),
        key("Z", "the targets, or the whole frame", letter("z"), () => mode.showTargets()),
        key(
          "Space and drag",
          "move the image; also the middle button, or two fingers",
          (event) => event.key === " " && event.target === stage.canvas,
          () => (gestures.panning = true),
        ),
        key("L", "go to the list of parts", letter("l"), () => (fixes ? mode.tabs.open(0) : list.focus())),
        ...(fixes ? [key("D", "go to the list of frames to review", letter("d"), () => mode.focusReview())] : []),
        key("P", "go to the image", letter("p"), () => stage.canvas.focus()),
        key("?", "this help", plain("?"), does.help),
      ],
    },
    {
      title: "General",
      keys: [
        key("Ctrl+Z", fixes ? "undo what was moved, then the last correction" : "undo", ctrl("z"), does.undo),
        key("Ctrl+Shift+Z", `redo${fixes ? " what was moved" : ""}; also Ctrl+Y`, redo, does.redo),
        key("Ctrl+S", "save", ctrl("s"), does.save, true),
      ],
    },
  ];
}

/** Listens to the keys of a table. */
export function listenToKeys(table) {
  const keys = table.flatMap((group) => group.keys).filter(({ test }) => test);
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.isComposing) return;
    const { target } = event;
    const typing = target.matches?.("input[type=text], input[type=number], textarea");
    const slider = target.matches?.("input[type=range]") && arrow(event);
    const dialog = document.querySelector("dialog[open]");
    for (const { test, action, always } of keys) {
      if (!test(event)) continue;
      if ((typing || slider || dialog) && !always) return;
      if (action(event) === false) continue;
      event.preventDefault();
      return;
    }
  });
}

/** The table as elements of the help. */
export function keyHelp(table) {
  const shown = (word) => (["or", "and"].includes(word) ? ` ${word} ` : make("kbd", {}, word.replaceAll("_", " ")));
  return table.map(({ title, keys }) => {
    const rows = keys
      .filter(({ show }) => show)
      .flatMap(({ show, text }) => [make("dt", {}, ...show.split(" ").map(shown)), make("dd", {}, text)]);
    return make("section", {}, make("h3", {}, title), make("dl", {}, ...rows));
  });
}
