// One of several panels at a time.

import { rove } from "./dom.js";

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
