// Save, what is lacking, and what comes after.

import * as api from "./api.js";
import { $, make, write } from "./dom.js";

/** What it says where a start is chosen, and where a run is put right. */
const WORDS = {
  pick: {
    faster: "Not saved: another window changed the start, or saves it. Look at it, then save again.",
    next: "To track from there:",
  },
  fix: {
    faster: "Not saved: another window is at work on the run. Look at it, then save again.",
    next: "For a report of it:",
  },
};

export class Save {
  /** `title()` is of what comes after. */
  constructor({ store, sync, say, onlack, title = () => "Saved" }) {
    Object.assign(this, { store, sync, say, onlack, title });
    this.words = WORDS[store.mode];
    write($("saved-for"), this.words.next);
    this.under = false;
    this.accepted = false;
    $("copy").addEventListener("click", () => this.#copy());
    $("saved-close").addEventListener("click", () => $("saved").close());
  }

  async save() {
    const { store, sync } = this;
    if (this.under || store.ended || store.live) return;
    this.under = true;
    this.#busy(true);
    this.lack("");
    try {
      await sync.flush();
      await api.post("save", { base: sync.revision });
      this.accepted = true;
      this.say(`Writing ${store.session.saves_to} …`);
      sync.fresh();
    } catch (error) {
      this.under = false;
      this.#busy(false);
      if (error instanceof api.Gone) this.say("Not saved: facetrack does not answer.", "error");
      else if (error.status === 409) {
        this.say(this.words.faster, "warning");
        sync.poll();
      } else {
        this.lack(error.message);
        if (error.status === 422) this.onlack();
      }
    }
  }

  lack(words) {
    $("lack").hidden = !words;
    write($("lack"), words);
  }

  /** What the server says of a job, of an end, or of a failure. */
  state({ ended, job, message }) {
    if (ended && !this.store.ended) this.#end(ended);
    else if (this.accepted && !ended && !job && message) {
      this.under = this.accepted = false;
      this.#busy(false);
      this.lack(message);
    }
  }

  #busy(busy) {
    $("save").disabled = busy;
    write($("save-label"), busy ? "Saving …" : "Save");
  }

  #end({ said, next }) {
    const { store } = this;
    store.ended = true;
    store.selected = store.current = null;
    store.emit("draft");
    document.body.classList.add("ended");
    this.#busy(true);
    write($("save-label"), this.title());
    write($("saved-title"), this.title());
    $("saved-said").replaceChildren(...said.map((line) => make("li", {}, line)));
    $("saved-next").hidden = !next;
    write($("next-command"), next ?? "");
    if (!$("saved").open) $("saved").showModal();
    this.say(said.join(". "));
  }

  async #copy() {
    const words = $("next-command").textContent;
    let done = true;
    try {
      await navigator.clipboard.writeText(words);
    } catch {
      // not allowed, or no such thing: the old way, by a selection
      getSelection().selectAllChildren($("next-command"));
      done = document.execCommand("copy");
    }
    write($("copy"), done ? "Copied" : "Press Ctrl+C");
    clearTimeout(this.copied);
    this.copied = setTimeout(() => write($("copy"), "Copy"), 2500);
  }
}
