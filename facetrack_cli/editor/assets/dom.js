// Helpers for elements and for texts.

export const $ = (id) => document.getElementById(id);
/** The page of all clips, if this page was opened from it. */
export const HOME = location.pathname.split("/").length > 3 ? "../" : null;
const SAID = 8000; // ms until a line disappears, if it is no error
export const TOUCH = window.matchMedia("(pointer: coarse)");

/** An element with attributes and children; functions become listeners, false and null attributes are left out. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value !== false && value !== null && value !== undefined)
      element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** A button that is no submit button; its test id is `id`. */
export const button = (id, attributes, ...children) =>
  make("button", { type: "button", "data-testid": id, ...attributes }, ...children);

/** An element of an SVG. */
export function drawn(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** One of the page's symbols, as an SVG. */
export const icon = (name, className = "icon") =>
  drawn("svg", { class: className, "aria-hidden": "true" }, drawn("use", { href: `#${name}` }));

/** A small square in the colour of a target. */
export function swatch(colour) {
  const element = make("span", { class: "swatch", "aria-hidden": "true" });
  element.style.backgroundColor = colour; // a style attribute would be against the page's policy
  return element;
}

/** A line at the bottom; `kind` is info, warning, error, or quiet: for screen readers alone. */
export function say(text, kind = "info") {
  const line = $("message");
  line.dataset.kind = kind;
  setText(line, text);
  clearTimeout(say.timer);
  if (kind !== "error") say.timer = setTimeout(() => setText(line, ""), SAID);
}

/** Changes a text only if it differs, so that a screen reader does not read it again. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** The arrow keys go through the buttons of a list, one of which is reached by Tab. */
export function rovingFocus(root, selector, forward = "ArrowDown", back = "ArrowUp") {
  const all = () => [...root.querySelectorAll(selector)];
  const only = (chosen) => all().forEach((one) => (one.tabIndex = one === chosen ? 0 : -1));
  root.addEventListener("focusin", (event) => event.target.matches(selector) && only(event.target));
  root.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || ![forward, back].includes(event.key)) return;
    const buttons = all();
    const at = buttons.indexOf(event.target.closest(selector) ?? event.target.closest("li")?.querySelector(selector));
    if (at < 0) return;
    buttons[Math.min(Math.max(at + (event.key === forward ? 1 : -1), 0), buttons.length - 1)].focus();
    event.preventDefault();
    event.stopPropagation();
  });
}

/** One of several panels at a time. */
export class Tabs {
  constructor(root) {
    this.buttons = [...root.querySelectorAll("[role=tab]")];
    this.panels = this.buttons.map((tab) => $(tab.getAttribute("aria-controls")));
    for (const [at, tab] of this.buttons.entries()) {
      this.panels[at].setAttribute("role", "tabpanel");
      this.panels[at].setAttribute("aria-labelledby", tab.id);
      tab.addEventListener("click", () => this.open(at));
      tab.addEventListener("focus", () => this.open(at));
    }
    rovingFocus(root, "[role=tab]", "ArrowRight", "ArrowLeft");
    this.open(0);
  }

  open(at) {
    if (this.at === at) return;
    this.panels[at].parentElement.scrollTop = 0;
    this.at = at;
    this.buttons.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === at));
      tab.tabIndex = i === at ? 0 : -1;
      this.panels[i].hidden = i !== at;
    });
  }
}

/** Shows the way back, if there is one. */
export function showHome() {
  for (const link of document.querySelectorAll("a.home")) {
    link.hidden = !HOME;
    if (HOME) link.href = HOME;
  }
}

// --- texts

export const formatNumber = (value) => String(Math.round(value * 100) / 100);
export const readable = (part) => part.replaceAll("_", " ");
export const percent = (share) => `${Math.round(share * 100)} %`;
export const plural = (n, one, more = `${one}s`) => `${n} ${n === 1 ? one : more}`;
export const capitalized = (text) => `${text[0].toUpperCase()}${text.slice(1)}`;
