// The list of the parts: what both pages share, and the list of those that a start requires.

import { $, button, formatNumber, icon, make, readable, rovingFocus, say, setText, swatch } from "./dom.js";
import { colour } from "./draw.js";
import { wrongName } from "./layout.js";
import { sameSlot, slotId } from "./store.js";

/** Rows by the id of their slots: {slot, item, button, ...}. A subclass has `chosen`, `update` and what it shows. */
export class PartList {
  constructor(store, options) {
    Object.assign(this, { store, ...options });
    this.root = $("parts");
    this.rows = new Map();
    for (const name of ["draft", "frame"]) store.addEventListener(name, () => this.update());
  }

  focus() {
    (this.rows.get(slotId(this.chosen)) ?? this.rows.values().next().value)?.button.focus();
  }

  /** Keeps the row of the chosen slot visible; without `again` only if it has changed. */
  follow(again = true) {
    const row = this.rows.get(slotId(this.chosen));
    if (!row || (row === this.followed && !again)) return;
    this.followed = row;
    row.item.scrollIntoView({ block: "nearest" });
  }

  section(target, slots, ...tools) {
    const title = make("h3", { id: `target-${target}` }, readable(target));
    const head = make("div", { class: "target-head" }, swatch(colour(this.store, target)), title, ...tools);
    const list = make("ul", { "aria-labelledby": `target-${target}` }, ...slots.map((slot) => this.row(slot)));
    return make("section", { class: "target", "data-testid": `target-${target}` }, head, list);
  }

  /** The button that chooses a slot. */
  partButton(slot, ...children) {
    // a click without a mouse button comes from Enter, or from a screen reader
    const click = (event) => this.choose(slot, event.detail === 0);
    return button(`part-${slot.target}-${slot.part}`, { class: "part", "data-slot": slotId(slot), click }, ...children);
  }

  markRow({ slot, item, button }, tabbed, chosen, current) {
    item.classList.toggle("current", chosen);
    button.tabIndex = sameSlot(tabbed, slot) ? 0 : -1;
    if (chosen) button.setAttribute("aria-current", current);
    else button.removeAttribute("aria-current");
  }
}

/** `choose(slot, byKey)` is called for a part that is clicked, or entered by the keyboard; `remove(slot)` removes it. */
export class PickList extends PartList {
  constructor(store, options) {
    super(store, options);
    this.shape = "";
    rovingFocus(this.root, ".part");
    this.root.addEventListener("keydown", (event) => this.#key(event));
    this.update();
  }

  get chosen() {
    return this.store.current;
  }

  update() {
    const { store } = this;
    const shape = JSON.stringify([store.layout.map(({ target, box, points }) => [target, box, points]), store.ended]);
    if (shape !== this.shape) {
      this.shape = shape;
      this.#build();
    }
    const tabbed = store.current ?? store.slots()[0];
    for (const row of this.rows.values()) {
      const value = store.value(row.slot);
      const optional = store.isOptional(row.slot);
      this.markRow(row, tabbed, sameSlot(store.current, row.slot), "step");
      row.item.classList.toggle("selected", !!value && sameSlot(store.selected, row.slot));
      row.item.classList.toggle("done", !!value);
      row.clear.hidden = !value || store.ended;
      setText(row.numbers, value ? shown(value) : optional ? "optional" : "");
      setText(row.status, value ? ", placed" : optional ? "" : ", missing");
    }
    const { done, of } = store.progress();
    setText($("progress"), of ? `${done} of ${of}` : "");
    this.follow(false);
  }

  #build() {
    const { store } = this;
    const focused = document.activeElement?.closest?.("[data-slot]")?.dataset.slot;
    this.rows.clear();
    const free = store.session.free && !store.ended;
    this.root.replaceChildren(...store.layout.map((group) => this.#group(group, free)));
    if (free) {
      const add = () => this.#ask("Name of the target", "", (name) => store.addTarget(name));
      this.root.append(button("add-target", { class: "adder", click: add }, icon("icon-plus"), "Target"));
    }
    if (focused) this.rows.get(focused)?.button.focus();
  }

  #group({ target }, free) {
    const { store } = this;
    const slots = store.slots().filter((slot) => slot.target === target);
    const rename = () => this.#ask("New name", target, (name) => store.rename(target, name));
    const remove = () => store.removeTarget(target);
    const tools = [
      button(`rename-${target}`, { class: "small", click: rename }, "Rename"),
      button(`remove-${target}`, { class: "small", click: remove }, "Remove"),
    ];
    return this.section(target, slots, ...(free ? tools : []));
  }

  row(slot) {
    const numbers = make("span", { class: "numbers" });
    const status = make("span", { class: "visually-hidden" });
    const tick = make("span", { class: "tick", "aria-hidden": "true" }, icon("icon-tick"));
    const choose = this.partButton(slot, tick, make("span", { class: "name" }, readable(slot.part)), status, numbers);
    const clear = button(
      `clear-${slot.target}-${slot.part}`,
      {
        class: "clear",
        tabindex: "-1",
        "aria-label": `Remove ${readable(slot.part)} of ${readable(slot.target)}`,
        click: () => this.remove(slot),
      },
      icon("icon-cross"),
    );
    const item = make("li", {}, choose, clear);
    this.rows.set(slotId(slot), { slot, item, button: choose, clear, numbers, status });
    return item;
  }

  #ask(question, value, done) {
    const name = prompt(question, value)?.trim().replaceAll(" ", "_");
    if (!name || name === value) return;
    const taken = this.store.layout.map(({ target }) => target);
    const wrong = wrongName(name, taken);
    if (wrong) say(wrong, "error");
    else done(name);
  }

  #key(event) {
    const here = event.target.closest?.("[data-slot]")?.dataset.slot;
    if (!here || !["Delete", "Backspace"].includes(event.key)) return;
    this.remove(this.rows.get(here).slot);
    event.preventDefault();
    event.stopPropagation();
  }
}

const shown = (value) => {
  const [x, y, w, h] = value.map(formatNumber);
  return value.length === 2 ? `${x}, ${y}` : `${x}, ${y} · ${w} × ${h}`;
};
