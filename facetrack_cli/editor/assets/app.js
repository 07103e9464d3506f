// Puts the page together.

import { Actions } from "./actions.js";
import * as api from "./api.js";
import { debug } from "./debug.js";
import { $, HOME, say, setText, showHome } from "./dom.js";
import { draftLayer } from "./draw.js";
import { firstOverview, Fix } from "./fix.js";
import { FixList } from "./fix_list.js";
import { FixStore } from "./fix_store.js";
import { Frames } from "./frames.js";
import { Gestures } from "./gestures.js";
import { keyHelp, keyTable, listenToKeys } from "./keys.js";
import { PickList } from "./list.js";
import { Magnifier } from "./magnifier.js";
import { showProblem } from "./mode.js";
import { Pick } from "./pick.js";
import { Clip } from "./playback.js";
import { Stage } from "./stage.js";
import { Store } from "./store.js";
import { Sync } from "./sync.js";

async function start() {
  const [session, state] = await Promise.all([api.session(), api.state()]);
  session.frames = state.frames;
  const fixes = session.mode === "fix";
  const overview = fixes ? await firstOverview() : null;
  if (fixes && !Object.keys(state.draft.targets).length) {
    state.draft.frame = overview.doubtful[0]?.frame ?? overview.first;
  }
  showHome();
  const store = fixes ? new FixStore(session, state.draft) : new Store(session, state.draft);
  showSession(session);

  const stage = new Stage($("stage"), session.size);
  const magnifier = new Magnifier($("magnifier"), stage, store, () => want());
  const frames = new Frames(store.bounds, {
    onimage: (image) => {
      stage.show(image);
      magnifier.paint();
      $("stage").setAttribute("aria-label", `Frame ${image.index} of ${session.clip}`);
    },
    onrefused: (index, error) => {
      say(error.message, "error");
      sync.poll();
      if (stage.image && stage.image.index !== index) store.show(stage.image.index);
    },
    onloading: (loading) => $("view").classList.toggle("loading", loading),
  });
  const want = () => frames.want(store.frame, magnifier.at ? 1 : stage.reduce);

  let lastMessage = null; // of the server
  const sync = new Sync(store, state, {
    onstate: (now) => {
      frames.bounds = now.frames;
      store.setBounds(now.frames);
      if (now.message && now.message !== lastMessage && !mode.running) say(now.message, "warning");
      lastMessage = now.message;
      mode.setState(now);
    },
    onoffline: () => {
      $("offline").hidden = false;
      if (HOME) setText($("offline-text"), "Start facetrack again; what was tracked is kept.");
    },
    ononline: () => {
      $("offline").hidden = true;
      say("facetrack answers again.");
      want();
      frames.load();
    },
    onrefused: (error) => say(`Refused by facetrack: ${error.message}`, "error"),
  });
  const hovered = () => gestures.hovered;
  const mode = fixes ? new Fix({ store, stage, sync, hovered, overview }) : new Pick({ store, stage, sync });
  const gestures = new Gestures(stage, store, magnifier, (explain) => mode.canEdit(explain));
  stage.layers.push(draftLayer(store, hovered));
  const clip = new Clip(store);
  const actions = new Actions({ store, stage, magnifier, gestures, clip, mode });
  const choose = (slot, byKey) => actions.choose(slot, byKey);
  const list = fixes
    ? new FixList(store, { choose, setAbsent: (slots, absent) => mode.setAbsent(slots, absent) })
    : new PickList(store, { choose, remove: (slot) => actions.remove(slot) });
  mode.setState(state);

  const undo = () => mode.undo();
  const redo = () => say(store.redo() ? "" : "There is nothing to redo.");
  const zoom = (factor) => stage.zoomBy(factor);
  const table = keyTable({ store, stage, clip, list, gestures, magnifier, mode, actions, undo, redo, zoom });
  listenToKeys(table);
  $("help-keys").replaceChildren(...keyHelp(table));
  // the ring around the image is for users of the keyboard
  document.addEventListener("keydown", () => document.body.classList.add("by-keys"), true);
  document.addEventListener("pointerdown", () => document.body.classList.remove("by-keys"), true);
  document.addEventListener("keyup", (event) => event.key === " " && (gestures.panning = false));
  window.addEventListener("blur", () => (gestures.panning = false));

  // --- buttons

  const press = (id, action) => $(id).addEventListener("click", action);
  press("undo", undo);
  press("redo", redo);
  press("save", () => mode.save());
  press("zoom-in", () => zoom(1.4));
  press("zoom-out", () => zoom(1 / 1.4));
  press("zoom-fit", () => mode.showTargets());
  press("help-open", () => $("help").showModal());
  press("help-close", () => $("help").close());
  press("saved-close", () => $("saved").close());
  for (const dialog of document.querySelectorAll("dialog")) {
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  }

  // --- what depends on the view and on the store

  let reducing;
  stage.onview = () => {
    setText($("zoom-level"), stage.fitted ? "Fit" : `${Math.round(stage.view.scale * 100)} %`);
    clearTimeout(reducing);
    reducing = setTimeout(want, 120); // a finer image once the zoom rests
    mode.update();
  };
  let opened = false; // whether it is known how large the targets are
  const changed = () => {
    opened ||= mode.showSmall() || !fixes;
    stage.draw();
    $("undo").disabled = !mode.undoable || store.ended;
    $("redo").disabled = !store.future.length || store.ended;
    if (!fixes && !store.nextMissing()) showProblem("");
  };
  store.addEventListener("draft", changed);
  store.addEventListener("commit", () => showProblem(""));
  store.addEventListener("frame", () => {
    gestures.cancel();
    want();
    stage.draw();
  });
  window.addEventListener("beforeunload", (event) => sync.dirty && sync.offline && event.preventDefault());
  changed();
  stage.onview();
  want();
  window.facetrack = debug({ store, stage, sync, mode });
  document.body.classList.add("ready");
}

function showSession({ clip, recipe, saves_to: place, mode }) {
  document.title = `${clip} – facetrack`;
  setText($("clip-name"), clip);
  setText($("recipe-name"), recipe ?? "");
  $("recipe-name").hidden = !recipe;
  $("save").title = `Write to ${place} (Ctrl+S)`;
  $("panel").setAttribute("aria-label", mode === "fix" ? "Parts, frames to review, corrections" : "Parts");
  document.body.dataset.mode = mode;
}

start().catch((error) => {
  $("offline").hidden = false;
  if (!(error instanceof api.Failed)) throw error;
  setText($("offline-text"), `${error.message}. Is it still running in its terminal?`);
});
