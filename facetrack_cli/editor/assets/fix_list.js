// The list of all parts of the run in the frame that is shown: how certain the tracker is, and what is absent.

import { button, icon, make, percent, readable, rovingFocus, setText, swatch } from "./dom.js";
import { colour } from "./draw.js";
import { isUncertain } from "./fix_store.js";
import { PartList } from "./list.js";
import { BOX, sameSlot, slotId } from "./store.js";

const MARKS = { moved: "hand", marked: "absent", absent: "absent", hidden: "hidden", lost: "lost", init: "init", tracked: "tracked" };

/** The report of a part in a few words. */
export function describe({ kind, confidence, byHand }) {
  const certain = confidence === null || confidence === undefined ? "" : percent(confidence);
  if (kind === "moved") return "moved";
  if (kind === "marked" || kind === "absent") return "absent";
  if (kind === "init") return byHand ? "by hand" : "start";
  if (kind === "lost" || kind === "hidden") return `${kind} ${certain}`.trim();
  return certain || (kind === "tracked" ? "tracked" : "");
}

const absentText = (absent) => (absent ? "Set present" : "Set absent");

/** `choose(slot, byKey)` as of PickList; `setAbsent(slots, absent)` marks parts as absent, or as present again. */
export class FixList extends PartList {
  constructor(store, options) {
    super(store, options);
    this.heads = new Map(); // target -> its button
    this.root.replaceChildren(...store.layout.map((group) => this.#group(group)));
    rovingFocus(this.root, ".part");
    this.update();
  }

  get chosen() {
    return this.store.selected ?? this.store.highlighted;
  }

  update() {
    const { store } = this;
    const off = store.busy || store.ended || !store.isHere() || store.frame === store.bounds.first;
    const tabbed = this.chosen ?? store.slots()[0];
    for (const row of this.rows.values()) this.#show(row, off, tabbed);
    for (const [target, head] of this.heads) {
      setText(head, absentText(this.#allAbsent(target)));
      head.disabled = off;
    }
    this.follow(false);
  }

  #allAbsent(target) {
    return this.store.parts(target).every((slot) => this.store.isAbsent(slot));
  }

  #show(row, off, tabbed) {
    const { store } = this;
    const { slot, item, absent, status, mark } = row;
    const boxOfPoints = store.isBoxOfPoints(slot);
    const report = boxOfPoints ? { kind: store.drafted(slot) ? "moved" : "" } : store.report(slot);
    this.markRow(row, tabbed, sameSlot(store.selected, slot) || sameSlot(store.highlighted, slot), "true");
    item.classList.toggle("armed", sameSlot(store.current, slot));
    item.dataset.kind = report.kind;
    item.dataset.uncertain = String(isUncertain(report));
    const shape = report.kind === "init" && report.byHand ? "hand" : MARKS[report.kind];
    mark.firstChild.setAttribute("href", shape ? `#mark-${shape}` : boxOfPoints ? "#icon-fit" : "#");
    setText(status, boxOfPoints && !report.kind ? "places all points" : describe(report));
    if (!absent) return;
    const text = absentText(store.isAbsent(slot));
    absent.tabIndex = row.button.tabIndex;
    setText(absent, text);
    absent.setAttribute("aria-label", `${readable(slot.part)} of ${readable(slot.target)}: ${text.toLowerCase()}`);
    absent.disabled = off || report.kind === "unknown";
  }

  #group({ target, box, points }) {
    const { store } = this;
    const parts = store.parts(target);
    if (!points.length) {
      // a target that is one box is one line
      const [item] = parts.map((slot) => this.row(slot, swatch(colour(store, target))));
      return make("ul", { class: "target", "data-testid": `target-${target}` }, item);
    }
    if (parts.length > 1) {
      const click = () => this.setAbsent(parts, !this.#allAbsent(target));
      const about = { "aria-describedby": `target-${target}` };
      this.heads.set(target, button(`absent-${target}`, { class: "small absent", click, ...about }));
    }
    const slots = box === "no" ? parts : [...parts, { target, part: BOX }];
    return this.section(target, slots, this.heads.get(target));
  }

  row(slot, square = null) {
    const { store } = this;
    const mark = icon("", "sign");
    const status = make("span", { class: "numbers" });
    const name = store.isBoxOfPoints(slot) ? "in a box" : readable(square ? slot.target : slot.part);
    const choose = this.partButton(slot, mark, square, make("span", { class: "name" }, name), status);
    const click = () => this.setAbsent([slot], !store.isAbsent(slot));
    const absent = store.isBoxOfPoints(slot)
      ? null
      : button(`absent-${slot.target}-${slot.part}`, { class: "small absent", click });
    const item = make("li", {}, choose, absent);
    this.rows.set(slotId(slot), { slot, item, button: choose, absent, status, mark });
    return item;
  }
}
