// The keyboard: one table, which is also what the help shows.

import { make } from "./dom.js";

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
