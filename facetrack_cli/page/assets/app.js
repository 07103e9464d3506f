// Puts the page together.

import * as api from "./api.js";
import { Clip } from "./clip.js";
import { debug } from "./debug.js";
import { $, spoken, write } from "./dom.js";
import { colour, marks } from "./draw.js";
import { middle, nudge, remove, stretch } from "./edit.js";
import { Frames } from "./frames.js";
import { Gestures } from "./gestures.js";
import { ctrl, Keys, plain } from "./keys.js";
import { List } from "./list.js";
import { Magnifier } from "./magnifier.js";
import { Pick } from "./pick.js";
import { Save } from "./save.js";
import { Stage } from "./stage.js";
import { BOX, same, Store } from "./store.js";
import { Sync } from "./sync.js";

const FAR = 25; // frames of PageUp and PageDown
const FADES = 8000; // ms until a message that needs no deed goes

function say(words, kind = "info") {
  const line = $("message");
  line.dataset.kind = kind;
  write(line, words);
  clearTimeout(say.timer);
  if (kind !== "error") say.timer = setTimeout(() => write(line, ""), FADES);
}

async function start() {
  const [session, state] = await Promise.all([api.session(), api.state()]);
  session.frames = state.frames ?? session.frames;
  const store = new Store(session, state.draft);
  document.title = `${session.clip} – facetrack`;
  write($("clip-name"), session.clip);
  write($("recipe-name"), session.recipe ?? "");
  $("recipe-name").hidden = !session.recipe;
  $("save").title = `Write to ${session.saves_to} (Ctrl+S)`;
  document.body.dataset.mode = session.mode;

  const stage = new Stage($("stage"), session.size);
  const magnifier = new Magnifier($("magnifier"), stage, store);
  const frames = new Frames(store.bounds, {
    onpicture: (picture) => {
      stage.show(picture);
      describe(store, picture);
    },
    onrefused: (index, error) => {
      say(error.message, "error");
      sync.poll();
      if (stage.picture && stage.picture.index !== index) store.show(stage.picture.index);
    },
    onwait: (waits) => $("view").classList.toggle("waits", waits),
  });
  const want = () => frames.want(store.frame, stage.reduce);

  // pick mode; fix mode brings its own in place of it
  const mode = new Pick({ store, stage, say });
  const may = (loud) => mode.may(loud);
  const gestures = new Gestures(stage, store, magnifier, { may, say });
  stage.layers.push(marks(store, () => gestures.hovered));
  const list = new List(store, { choose, may, say });
  const clip = new Clip(store);
  let heard = null; // the last message of the server
  const sync = new Sync(store, state, {
    onstate: (now) => {
      if (now.frames) {
        frames.bounds = now.frames;
        store.bound(now.frames);
      }
      if (now.message && now.message !== heard) say(now.message, "warning");
      heard = now.message;
      save.state(now);
    },
    onothers: (lost) =>
      say(
        lost
          ? "Another window was faster: its start is shown now. Undo brings back yours."
          : "Changed in another window.",
        "warning",
      ),
    ongone: () => {
      $("gone").hidden = false;
      if (save.accepted) {
        write($("gone-text"), "facetrack has ended; its terminal says what it wrote.");
      }
    },
    onback: () => {
      $("gone").hidden = true;
      say("facetrack answers again.");
      want();
      frames.retry();
    },
    onrefused: (error) => say(`Not taken by facetrack: ${error.message}`, "error"),
  });
  const save = new Save({ store, sync, say, onlack });
  save.state(state);

  function onlack() {
    const lacking = store.next();
    if (lacking) store.pick(lacking);
    list.follow();
  }

  // --- a part of the list, or Enter

  function place(slot) {
    if (!may(true)) return;
    const at = middle(store, stage, slot);
    store.set(slot, at);
    store.advance(slot);
    tell(slot);
  }

  function tell(slot) {
    const value = store.value(slot);
    if (!value) return;
    if (slot.part !== BOX) {
      stage.reveal(...value);
      magnifier.show(...value, "keys", colour(store, slot.target));
      magnifier.hide(2500);
    }
    say(`${spoken(slot.part)} of ${spoken(slot.target)} at ${value.map((one) => Math.round(one * 100) / 100).join(", ")}`);
  }

  function choose(slot, byKey) {
    if (store.ended) return;
    store.pick(slot);
    if (byKey && !store.value(slot)) place(slot);
    else tell(slot);
    stage.canvas.focus({ preventScroll: true });
  }

  function enter() {
    if (store.ended || ![stage.canvas, document.body].includes(document.activeElement)) return false;
    const open = store.current && !store.value(store.current) ? store.current : store.next(store.selected);
    if (open) place(open);
    else say("All is there. Ctrl+S saves."); // never by one Enter too many
    return true;
  }

  function arrow(event) {
    const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const selected = store.value(store.selected) ? store.selected : null;
    if (!selected) return dx && !event.ctrlKey && !event.altKey ? clip.by(dx * (event.shiftKey ? FAR : 1)) : false;
    if (!may(true)) return true;
    const step = event.shiftKey ? 10 : event.altKey ? 0.25 : 1;
    if (event.ctrlKey || event.metaKey) {
      if (selected.part !== BOX) return false;
      stretch(store, dx * step, dy * step);
    } else nudge(store, dx * step, dy * step);
    tell(selected);
    return true;
  }

  const isArrow = (event) => event.key.startsWith("Arrow");
  const undo = () => say(store.undo() ? "" : "There is nothing to take back.");
  const redo = () => say(store.redo() ? "" : "There is nothing to do again.");
  const zoom = (factor) => () => stage.zoomBy(factor);
  const help = () => !$("help").open && $("help").showModal();
  const keys = new Keys([
    {
      title: "Marks",
      keys: [
        { show: "Enter", does: "in the list: choose the part, and put it in the middle; on the picture: on to the next", test: (e) => e.key === "Enter", deed: enter },
        { show: "← ↑ ↓ →", does: "nudge the selected mark by 1 pixel", test: isArrow, deed: arrow },
        { show: "Shift or Alt and arrows", does: "by 10 pixels, or by a quarter of one" },
        { show: "Ctrl and arrows", does: "move a box's right and bottom edges" },
        { show: "[ and ]", does: "previous and next part", test: plain("[", "]"), deed: (e) => step(e.key === "]" ? 1 : -1) },
        { show: "Delete", does: "remove the selected mark", test: plain("Delete", "Backspace"), deed: () => store.value(store.selected) && may(true) && remove(store, store.selected) },
        { show: "Esc", does: "select nothing; end what is being drawn", test: plain("Escape"), deed: escape },
        { show: "1 … 9", does: "take what was found: face 1, face 2", test: (e) => plain(e.key)(e) && /^[1-9]$/.test(e.key), deed: (e) => mode.take(Number(e.key) - 1) },
        { show: "M", does: "magnifier on or off", test: plain("m", "M"), deed: () => say(`Magnifier ${magnifier.toggle() ? "on" : "off"}.`) },
      ],
    },
    {
      title: "Clip",
      keys: [
        { show: "← or →", does: "one frame, while no mark is selected (Shift: 25)" },
        { show: ", and .", does: "one frame back or on, always", test: plain(",", "."), deed: (e) => clip.by(e.key === "," ? -1 : 1) },
        { show: "Page_Up and Page_Down", does: `${FAR} frames back or on`, test: plain("PageUp", "PageDown"), deed: (e) => clip.by(e.key === "PageUp" ? -FAR : FAR) },
        { show: "Home and End", does: "first and last frame", test: plain("Home", "End"), deed: (e) => store.show(e.key === "Home" ? store.bounds.first : store.bounds.last) },
        { show: "F", does: "type the number of a frame", test: plain("f", "F"), deed: () => $("frame-number").select() ?? $("frame-number").focus() },
        { show: "G", does: "back to the frame of the marks", test: plain("g", "G"), deed: () => mode.goBack() },
        { show: "B", does: "begin here: the marks are of this frame", test: plain("b", "B"), deed: () => mode.beginHere() },
      ],
    },
    {
      title: "View",
      keys: [
        { show: "+ or −", does: "zoom; the wheel, or two fingers, too", test: plain("+", "="), deed: zoom(1.25) },
        { test: plain("-", "−"), deed: zoom(0.8) },
        { show: "0", does: "the whole picture", test: plain("0"), deed: () => stage.toFit() },
        { show: "Space and drag", does: "move the picture; the middle button, or two fingers, too", test: (e) => e.key === " " && e.target === stage.canvas, deed: () => (gestures.panning = true) },
        { show: "L", does: "to the list of parts", test: plain("l", "L"), deed: () => list.focus() },
        { show: "P", does: "to the picture", test: plain("p", "P"), deed: () => stage.canvas.focus() },
        { show: "?", does: "this help", test: plain("?"), deed: help },
      ],
    },
    {
      title: "All of it",
      keys: [
        { show: "Ctrl+Z", does: "undo", test: ctrl("z"), deed: undo },
        { show: "Ctrl+Shift+Z", does: "redo (Ctrl+Y too)", test: (e) => ctrl("z", true)(e) || ctrl("y")(e), deed: redo },
        { show: "Ctrl+S", does: "save", test: ctrl("s"), deed: () => void save.save(), always: true },
      ],
    },
  ]);
  $("help-keys").replaceChildren(...keys.help());
  // the ring around the picture is for those who are at the keyboard
  document.addEventListener("keydown", () => document.body.classList.add("by-keys"), true);
  document.addEventListener("pointerdown", () => document.body.classList.remove("by-keys"), true);
  document.addEventListener("keyup", (event) => event.key === " " && (gestures.panning = false));
  window.addEventListener("blur", () => (gestures.panning = false));

  function step(by) {
    const all = store.slots();
    const at = all.findIndex((slot) => same(slot, store.selected ?? store.current));
    const slot = all[(at + by + all.length) % all.length];
    if (slot) choose(slot, false);
  }

  function escape() {
    if (store.live) return gestures.cancel();
    magnifier.hide();
    store.selected = null;
    if (store.value(store.current)) store.current = store.next();
    store.emit("draft");
    return true;
  }

  // --- buttons

  const press = (id, deed) => $(id).addEventListener("click", deed);
  press("undo", undo);
  press("redo", redo);
  press("zoom-in", zoom(1.4));
  press("zoom-out", zoom(1 / 1.4));
  press("zoom-fit", () => stage.toFit());
  press("help-open", help);
  press("help-close", () => $("help").close());
  for (const dialog of document.querySelectorAll("dialog")) {
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  }

  // --- what depends on what

  let reducing;
  stage.onview = () => {
    write($("zoom-level"), stage.fitted ? "Fit" : `${Math.round(stage.view.scale * 100)} %`);
    clearTimeout(reducing);
    reducing = setTimeout(want, 120); // finer pixels once zooming rests
    mode.update();
  };
  const changed = () => {
    stage.draw();
    $("undo").disabled = !store.past.length || store.ended;
    $("redo").disabled = !store.future.length || store.ended;
    if (!store.next()) save.lack("");
  };
  store.addEventListener("draft", changed);
  store.addEventListener("commit", () => save.lack(""));
  store.addEventListener("frame", () => {
    gestures.cancel();
    want();
    stage.draw();
  });
  window.addEventListener("beforeunload", (event) => sync.dirty && sync.gone && event.preventDefault());
  changed();
  stage.onview();
  want();
  window.facetrack = debug({ store, stage, sync });
  document.body.classList.add("ready");
}

// what a screen reader is told of the picture
function describe(store, { index }) {
  $("stage").setAttribute("aria-label", `Frame ${index} of ${store.session.clip}`);
}

start().catch((error) => {
  $("gone").hidden = false;
  write($("gone-text"), error instanceof api.Refused ? error.message : "facetrack does not answer. Is it still running in its terminal?");
  if (!(error instanceof api.Refused || error instanceof api.Gone)) throw error;
});
