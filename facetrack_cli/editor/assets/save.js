// Save, and what is shown afterwards.

import * as api from "./api.js";
import { $, HOME, make, setText } from "./dom.js";

const TEXTS = {
  pick: {
    conflict: "Not saved: another window has changed the start, or is saving it. Check it, then save again.",
    next: "To track from there:",
  },
  fix: {
    conflict: "Not saved: another window is working on the run. Check it, then save again.",
    next: "To make its report:",
  },
};

/** Shows a problem above the buttons, or hides it (""). */
export function showProblem(text) {
  $("problem").hidden = !text;
  setText($("problem"), text);
}

export class Save {
  /** `title()` is the title of what is shown afterwards; `onmissing()` is called if something is missing. */
  constructor({ store, sync, say, onmissing, title }) {
    Object.assign(this, { store, sync, say, onmissing, title });
    this.texts = TEXTS[store.mode];
    setText($("saved-for"), this.texts.next);
    this.running = false;
    this.accepted = false;
    this.saves = null; // how often the run was saved, of a page that goes on
    $("copy").addEventListener("click", () => this.#copy());
    $("saved-close").addEventListener("click", () => $("saved").close());
  }

  async save() {
    const { store, sync } = this;
    if (this.running || store.ended || store.beforeGesture) return;
    this.#setRunning(true);
    showProblem("");
    try {
      await sync.flush();
      await api.post("save", { base: sync.revision });
      this.accepted = true;
      this.say(`Writing ${store.session.saves_to} …`);
      sync.pollAgain();
    } catch (error) {
      this.#setRunning(false);
      if (error instanceof api.Unreachable) this.say("Not saved: facetrack does not answer.", "error");
      else if (error.status === 409) {
        this.say(this.texts.conflict, "warning");
        sync.poll();
      } else {
        showProblem(error.message);
        if (error.status === 422) this.onmissing();
      }
    }
  }

  /** The server's state: a job, the end, or a failure. */
  update({ ended, job, message, saves, saved }) {
    const goesOn = this.saves !== null && saves > this.saves;
    this.saves = saves ?? null;
    if (ended && !this.store.ended) this.#end(ended);
    else if (!ended && !job && goesOn) {
      this.accepted = false;
      this.#setRunning(false);
      this.say(`Saved. ${saved.join(". ")}`);
    } else if (this.accepted && !ended && !job && message) {
      this.accepted = false;
      this.#setRunning(false);
      showProblem(message);
    }
  }

  #setRunning(running) {
    this.running = running;
    $("save").disabled = running;
    setText($("save-label"), running ? "Saving …" : "Save");
  }

  #end({ messages, next }) {
    const { store } = this;
    store.ended = true;
    store.selected = store.current = null;
    store.emit("draft");
    document.body.classList.add("ended");
    $("save").disabled = true;
    setText($("save-label"), this.title());
    setText($("saved-title"), this.title());
    $("saved-messages").replaceChildren(...messages.map((line) => make("li", {}, line)));
    $("saved-next").hidden = !next || !!HOME;
    $("saved-quiet").hidden = !!HOME;
    setText($("next-command"), next ?? "");
    if (!$("saved").open) $("saved").showModal();
    this.say(messages.join(". "));
  }

  async #copy() {
    let done = true;
    try {
      await navigator.clipboard.writeText($("next-command").textContent);
    } catch {
      // not allowed, or not available: by a selection
      getSelection().selectAllChildren($("next-command"));
      done = document.execCommand("copy");
    }
    setText($("copy"), done ? "Copied" : "Press Ctrl+C");
    clearTimeout(this.copied);
    this.copied = setTimeout(() => setText($("copy"), "Copy"), 2500);
  }
}
