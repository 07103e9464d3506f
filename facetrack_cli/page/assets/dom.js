// Small helpers for elements.

export const $ = (id) => document.getElementById(id);

/** An element with attributes and children; functions become listeners, false and null attributes are left out. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value === true ? "" : value);
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

export const number = (value) => String(Math.round(value * 100) / 100);
export const spoken = (part) => part.replaceAll("_", " ");
