// The parts that are wanted, as a list to work through.

import { remove } from "./actions.js";
import { $, icon, make, number, spoken, write } from "./dom.js";
import { colour } from "./draw.js";
import { wrongName } from "./layout.js";
import { BOX, same } from "./store.js";

/** `choose(slot, byKey)` is called for a part of the list that is clicked, or entered by the keyboard. */
export class List {
  constructor(store, { choose, may, say }) {
    Object.assign(this, { store, choose, may, say });
    this.root = $("parts");
    this.rows = new Map();
    this.shape = "";
    this.root.addEventListener("keydown", (event) => this.#key(event));
    store.addEventListener("draft", () => this.update());
    store.addEventListener("frame", () => this.update());
    this.update();
  }

  focus(slot = this.store.current) {
    (this.rows.get(id(slot)) ?? this.rows.values().next().value)?.button.focus();
  }

  update() {
    const { store } = this;
    const shape = JSON.stringify([store.layout.map(({ target, box, points }) => [target, box, points]), store.ended]);
    if (shape !== this.shape) {
      this.shape = shape;
      this.#build();
    }
    const tabbed = store.current ?? store.slots()[0];
    for (const [, row] of this.rows) {
      const value = store.value(row.slot);
      const current = same(store.current, row.slot);
      row.item.classList.toggle("current", current);
      row.item.classList.toggle("selected", !!value && same(store.selected, row.slot));
      row.item.classList.toggle("done", !!value);
      row.clear.hidden = !value || store.ended;
      row.button.tabIndex = same(tabbed, row.slot) ? 0 : -1;
      if (current) row.button.setAttribute("aria-current", "step");
      else row.button.removeAttribute("aria-current");
      write(row.numbers, value ? shown(value) : store.optional(row.slot) ? "if you like" : "");
      write(row.spoken, value ? ", placed" : store.optional(row.slot) ? ", optional" : ", lacking");
    }
    const { done, of } = store.progress();
    write($("progress"), of ? `${done} of ${of}` : "");
    this.follow(false);
  }

  /** The current row is kept in sight, the list alone being scrolled. */
  follow(anew = true) {
    const row = this.rows.get(id(this.store.current));
    if (!row || (row === this.followed && !anew)) return;
    this.followed = row;
    const scroller = $("panel-body");
    const [box, at] = [scroller.getBoundingClientRect(), row.item.getBoundingClientRect()];
    if (at.top < box.top) scroller.scrollTop += at.top - box.top - 8;
    else if (at.bottom > box.bottom) scroller.scrollTop += at.bottom - box.bottom + 8;
  }

  #build() {
    const { store } = this;
    const focused = document.activeElement?.closest?.("[data-slot]")?.dataset.slot;
    this.rows.clear();
    const free = store.session.free && !store.ended;
    this.root.replaceChildren(...store.layout.map((group) => this.#group(group, free)));
    if (free) this.root.append(this.#adder());
    if (focused) this.rows.get(focused)?.button.focus();
  }

  #group({ target, box, points }, free) {
    const { store } = this;
    const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
    swatch.style.backgroundColor = colour(store, target);
    const slots = [...(box === "no" ? [] : [BOX]), ...points].map((part) => ({ target, part }));
    const head = make("div", { class: "target-head" }, swatch, make("h3", { id: `target-${target}` }, spoken(target)));
    if (free) {
      const renames = () =>
        this.#ask(head, "New name", target, (name) => store.rename(target, name), names(store, target));
      head.append(
        make("button", { class: "small", type: "button", click: renames, "data-testid": `rename-${target}` }, "Rename"),
        make(
          "button",
          {
            class: "small",
            type: "button",
            click: () => store.removeTarget(target),
            "data-testid": `remove-${target}`,
          },
          "Remove",
        ),
      );
    }
    const list = make("ul", { "aria-labelledby": `target-${target}` }, ...slots.map((slot) => this.#row(slot)));
    return make("section", { class: "target", "data-testid": `target-${target}` }, head, list);
  }

  #row(slot) {
    const numbers = make("span", { class: "numbers" });
    const said = make("span", { class: "unseen" });
    const button = make(
      "button",
      { class: "part", type: "button", "data-slot": id(slot), "data-testid": `part-${slot.target}-${slot.part}` },
      make("span", { class: "tick", "aria-hidden": "true" }, icon("tick")),
      make("span", { class: "name" }, spoken(slot.part)),
      said,
      numbers,
    );
    // a click without a button of the mouse is Enter, or a screen reader's
    button.addEventListener("click", (event) => this.choose(slot, event.detail === 0));
    const clear = make(
      "button",
      { class: "clear", type: "button", tabindex: "-1", "data-testid": `clear-${slot.target}-${slot.part}` },
      icon("cross"),
    );
    clear.setAttribute("aria-label", `Remove ${spoken(slot.part)} of ${spoken(slot.target)}`);
    clear.addEventListener("click", () => this.may(true) && remove(this.store, slot));
    const item = make("li", {}, button, clear);
    this.rows.set(id(slot), { slot, item, button, clear, numbers, spoken: said });
    return item;
  }

  #adder() {
    const add = make("button", { class: "adder", type: "button", "data-testid": "add-target" }, icon("plus"), "Target");
    add.addEventListener("click", () =>
      this.#ask(add, "Name of the target", "", (name) => this.store.addTarget(name), names(this.store)),
    );
    return add;
  }

  // a field in place of what was clicked
  #ask(place, label, value, done, taken) {
    const input = make("input", { type: "text", value, "aria-label": label, placeholder: label, spellcheck: "false" });
    input.setAttribute("data-testid", "name-field");
    input.setAttribute("autocapitalize", "off");
    input.setAttribute("autocomplete", "off");
    const form = make("form", { class: "ask" }, input);
    form.append(make("button", { class: "small", type: "submit" }, "OK"));
    const close = () => {
      if (form.isConnected) form.replaceWith(place);
    };
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const name = input.value.trim().replaceAll(" ", "_");
      if (name === value) return close();
      const wrong = wrongName(name, taken);
      if (wrong) return this.say(wrong, "error");
      close();
      done(name);
      this.focus();
    });
    form.addEventListener("keydown", (event) => {
      event.stopPropagation();
      if (event.key === "Escape") {
        close();
        place.focus?.();
      }
    });
    form.addEventListener("focusout", (event) => form.contains(event.relatedTarget) || setTimeout(close));
    place.replaceWith(form);
    input.focus();
    input.select();
  }

  #key(event) {
    const here = event.target.closest?.("[data-slot]")?.dataset.slot;
    if (!here || event.ctrlKey || event.metaKey || event.altKey) return;
    const all = [...this.rows.keys()];
    const at = all.indexOf(here);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1 }[event.key];
    if (to !== undefined) this.rows.get(all[Math.min(Math.max(to, 0), all.length - 1)]).button.focus();
    else if (event.key === "Delete" || event.key === "Backspace") {
      if (this.may(true)) remove(this.store, this.rows.get(here).slot);
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }
}

const id = (slot) => (slot ? `${slot.target}/${slot.part}` : "");
const names = (store, but) => store.layout.map(({ target }) => target).filter((name) => name !== but);
const shown = (value) =>
  value.length === 2
    ? value.map(number).join(", ")
    : `${number(value[0])}, ${number(value[1])} · ${number(value[2])} × ${number(value[3])}`;
