// Small helpers for elements.

export const $ = (id) => document.getElementById(id);

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

/** One of the page's symbols, as an SVG. */
export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  use.setAttribute("href", `#icon-${name}`);
  svg.append(use);
  return svg;
}

/** Changes a text only if it differs, so that it is not read out anew. */
export function write(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

/** Draws the eye to an element. */
export function flash(element) {
  element.classList.remove("flash");
  void element.offsetWidth; // so that the animation begins anew
  element.classList.add("flash");
}

/** The arrow keys go through the buttons of a list, of which one is reached by Tab. */
export function rove(root, selector, forth = "ArrowDown", back = "ArrowUp") {
  const all = () => [...root.querySelectorAll(selector)];
  const only = (chosen) => all().forEach((one) => (one.tabIndex = one === chosen ? 0 : -1));
  root.addEventListener("focusin", (event) => event.target.matches(selector) && only(event.target));
  root.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || ![forth, back].includes(event.key)) return;
    const buttons = all();
    const at = buttons.indexOf(event.target.closest(selector) ?? event.target.closest("li")?.querySelector(selector));
    if (at < 0) return;
    buttons[Math.min(Math.max(at + (event.key === forth ? 1 : -1), 0), buttons.length - 1)].focus();
    event.preventDefault();
    event.stopPropagation();
  });
}

export const number = (value) => String(Math.round(value * 100) / 100);
export const spoken = (part) => part.replaceAll("_", " ");

// One of several panels at a time.

export class Tabs {
  constructor(root) {
    this.buttons = [...root.querySelectorAll("[role=tab]")];
    this.panels = this.buttons.map((button) => document.getElementById(button.getAttribute("aria-controls")));
    for (const [at, button] of this.buttons.entries()) {
      this.panels[at].setAttribute("role", "tabpanel");
      this.panels[at].setAttribute("aria-labelledby", button.id);
      button.addEventListener("click", () => this.open(at));
      button.addEventListener("focus", () => this.open(at));
    }
    rove(root, "[role=tab]", "ArrowRight", "ArrowLeft");
    this.open(0);
  }

  open(at) {
    if (this.at === at) return;
    this.panels[at].parentElement.scrollTop = 0;
    this.at = at;
    this.buttons.forEach((button, i) => {
      button.setAttribute("aria-selected", String(i === at));
      button.tabIndex = i === at ? 0 : -1;
      this.panels[i].hidden = i !== at;
    });
  }
}

// A question before what cannot be taken back.

/** Whether the user wants it; `yes` is on the button that says so. */
export function confirmed(title, text, yes) {
  const dialog = $("confirm");
  if (dialog.open) return Promise.resolve(false);
  write($("confirm-title"), title);
  write($("confirm-text"), text);
  write($("confirm-yes"), yes);
  return new Promise((tell) => {
    let answer = false;
    const agree = () => {
      answer = true;
      dialog.close();
    };
    const deny = () => dialog.close();
    const closed = () => {
      $("confirm-yes").removeEventListener("click", agree);
      $("confirm-no").removeEventListener("click", deny);
      dialog.removeEventListener("close", closed);
      tell(answer);
    };
    $("confirm-yes").addEventListener("click", agree);
    $("confirm-no").addEventListener("click", deny);
    dialog.addEventListener("close", closed);
    dialog.showModal();
  });
}
