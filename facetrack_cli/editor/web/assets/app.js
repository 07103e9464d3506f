// Puts the page together.

import { Deeds } from "./actions.js";
import * as api from "./api.js";
import { debug } from "./debug.js";
import { $, write } from "./dom.js";
import { marks } from "./draw.js";
import { Fix, overview } from "./fix.js";
import { FixList } from "./fix_list.js";
import { FixStore } from "./fix_store.js";
import { Frames } from "./frames.js";
import { Gestures } from "./gestures.js";
import { Keys, keytable } from "./keys.js";
import { List } from "./list.js";
import { Magnifier } from "./magnifier.js";
import { Pick } from "./pick.js";
import { Clip } from "./playback.js";
import { Save } from "./save.js";
import { Stage } from "./stage.js";
import { Store } from "./store.js";
import { Sync } from "./sync.js";

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
  const fixes = session.mode === "fix";
  const first = fixes ? await overview() : null;
  if (first && isBlank(state.draft)) state.draft.frame = first.doubtful[0]?.frame ?? first.first;
  const store = fixes ? new FixStore(session, state.draft) : new Store(session, state.draft);
  document.title = `${session.clip} – facetrack`;
  write($("clip-name"), session.clip);
  write($("recipe-name"), session.recipe ?? "");
  $("recipe-name").hidden = !session.recipe;
  $("save").title = `Write to ${session.saves_to} (Ctrl+S)`;
  $("panel").setAttribute("aria-label", fixes ? "Parts, doubtful frames and corrections" : "Parts");
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

  let heard = null; // the last message of the server
  const sync = new Sync(store, state, {
    onstate: (now) => {
      if (now.frames) {
        frames.bounds = now.frames;
        store.bound(now.frames);
      }
      if (now.message && now.message !== heard && !mode.hears?.()) say(now.message, "warning");
      heard = now.message;
      mode.state?.(now);
      save.state(now);
    },
    onothers: (lost) => {
      if (mode.others) return mode.others(lost);
      say(
        lost
          ? "Another window was faster: its start is shown now. Undo brings back yours."
          : "Changed in another window.",
        "warning",
      );
    },
    ongone: () => {
      $("gone").hidden = false;
      if (save.accepted) write($("gone-text"), "facetrack has ended; its terminal says what it wrote.");
    },
    onback: () => {
      $("gone").hidden = true;
      say("facetrack answers again.");
      want();
      frames.retry();
    },
    onrefused: (error) => say(`Not taken by facetrack: ${error.message}`, "error"),
  });
  const lack = (words) => save.lack(words);
  const hovered = () => gestures.hovered;
  const mode = first ? new Fix({ store, stage, sync, say, lack, hovered, first }) : new Pick({ store, stage, say });
  const may = (loud) => mode.may(loud);
  const gestures = new Gestures(stage, store, magnifier, { may, say });
  stage.layers.push(marks(store, hovered));
  const clip = new Clip(store);
  const deeds = new Deeds({ store, stage, magnifier, gestures, clip, mode, say });
  const choose = (slot, byKey) => deeds.choose(slot, byKey);
  const list = first
    ? new FixList(store, { choose, absent: (slots, whether) => mode.absent(slots, whether) })
    : new List(store, { choose, may, say });
  const save = new Save({ store, sync, say, onlack, title: () => (first && !mode.canUndo ? "Ended" : "Saved") });
  mode.state?.(state);
  save.state(state);

  function onlack() {
    const lacking = store.next();
    if (lacking) store.pick(lacking);
    list.follow();
  }

  const does = {
    say,
    undo: () => (mode.undo ? mode.undo() : say(store.undo() ? "" : "There is nothing to take back.")),
    redo: () => say(store.redo() ? "" : "There is nothing to do again."),
    zoom: (factor) => () => stage.zoomBy(factor),
    help: () => !$("help").open && $("help").showModal(),
    save: () => void (mode.save ? mode.save(save) : save.save()),
  };
  const keys = new Keys(keytable({ store, stage, clip, list, gestures, magnifier, mode, deeds, does }));
  $("help-keys").replaceChildren(...keys.help());
  // the ring around the picture is for those who are at the keyboard
  document.addEventListener("keydown", () => document.body.classList.add("by-keys"), true);
  document.addEventListener("pointerdown", () => document.body.classList.remove("by-keys"), true);
  document.addEventListener("keyup", (event) => event.key === " " && (gestures.panning = false));
  window.addEventListener("blur", () => (gestures.panning = false));

  // --- buttons

  const press = (id, deed) => $(id).addEventListener("click", deed);
  press("undo", does.undo);
  press("redo", does.redo);
  press("save", does.save);
  press("zoom-in", does.zoom(1.4));
  press("zoom-out", does.zoom(1 / 1.4));
  press("zoom-fit", () => stage.toFit());
  press("help-open", does.help);
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
    $("undo").disabled = !(mode.undoes ?? store.past.length) || store.ended;
    $("redo").disabled = !store.future.length || store.ended;
    if (store.mode === "pick" && !store.next()) save.lack("");
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
  window.facetrack = debug({ store, stage, sync, mode });
  document.body.classList.add("ready");
}

const isBlank = ({ targets }) => !Object.keys(targets).length;

// what a screen reader is told of the picture
function describe(store, { index }) {
  $("stage").setAttribute("aria-label", `Frame ${index} of ${store.session.clip}`);
}

start().catch((error) => {
  $("gone").hidden = false;
  write(
    $("gone-text"),
    error instanceof api.Refused ? error.message : "facetrack does not answer. Is it still running in its terminal?",
  );
  if (!(error instanceof api.Refused || error instanceof api.Gone)) throw error;
});
