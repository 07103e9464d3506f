// The page of a film's cast: people are merged, renamed and split, and doubts are settled.

import * as api from "./api.js";
import { $, drawn, HOME, make, say, showHome } from "./dom.js";

const POLL = 1000; // ms
let now = null; // the state that the server told last
let chosen = null; // {name, frame} on the timeline
let doubt = 0; // index of the doubt that is shown

const still = (track) =>
  `api/still?first=${track.first}&stop=${track.stop}&person=${encodeURIComponent(track.person)}`;
const longest = (name) =>
  now.tracks.filter((one) => one.person === name).reduce((a, b) => (b.stop - b.first > a.stop - a.first ? b : a));
const clock = (frame) => {
  // between two frames whose times are told in proportion, beyond them at the nominal rate
  const next = Math.max(now.clock.findIndex(([at]) => at >= frame), 0);
  const [at, time] = frame > now.clock.at(-1)[0] ? now.clock.at(-1) : now.clock[next];
  const [before, earlier] = now.clock[next - 1] ?? [at - now.fps, time - 1];
  const slope = frame < at ? (time - earlier) / (at - before) : 1 / now.fps;
  const seconds = Math.max(time + (frame - at) * slope, 0);
  return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(2).padStart(5, "0")}`;
};

async function ask(path, body) {
  try {
    show(await api.post(path, body));
    say(now.changes.at(-1) ?? "");
  } catch (error) {
    render();
    say(error.message);
  }
}

const change = (what, name, more) => ask(what, { name, ...more });

/** A person may be dragged onto another: both are one. */
function draggable(part, name) {
  part.draggable = true;
  part.addEventListener("dragstart", (event) => event.dataTransfer.setData("text/plain", name));
  part.addEventListener("dragover", (event) => {
    event.preventDefault();
    part.classList.add("over");
  });
  part.addEventListener("dragleave", () => part.classList.remove("over"));
  part.addEventListener("drop", (event) => {
    event.preventDefault();
    part.classList.remove("over");
    const other = event.dataTransfer.getData("text/plain");
    if (other && other !== name) change("merge", other, { to: name });
  });
  return part;
}

function card(person) {
  const { name } = person;
  const picture = make("img", { src: still(longest(name)), alt: name });
  const label = make("input", { value: name, "aria-label": `name of ${name}`, maxlength: 60 });
  label.addEventListener("change", () => label.value.trim() && change("rename", name, { to: label.value.trim() }));
  label.addEventListener("keydown", (event) => event.key === "Enter" && label.blur());
  const into = make("select", { "aria-label": `${name} is` }, make("option", { value: "" }, "is also..."));
  for (const other of now.people) if (other.name !== name) into.append(make("option", { value: other.name }, other.name));
  into.addEventListener("change", () => into.value && change("merge", name, { to: into.value }));
  const count = `${person.seconds.toFixed(1)} s, ${person.intervals.length} times`;
  const about = make("small", {}, count, make("br"), `P ${person.p.toFixed(2)}${person.photograph ? ", a photograph" : ""}`);
  return draggable(make("li", { "data-name": name }, picture, label, about, into), name);
}

function row(person) {
  const span = now.last + 1 - now.first;
  const bar = drawn("svg", { viewBox: `0 0 ${span} 10`, preserveAspectRatio: "none", role: "img" });
  bar.setAttribute("aria-label", `${person.name}: ${person.intervals.length} times`);
  for (const track of now.tracks.filter((one) => one.person === person.name)) {
    const kind = track.doubt && !track.given ? { class: "doubt" } : {};
    bar.append(drawn("rect", { x: track.first - now.first, y: 0, width: track.stop - track.first, height: 10, ...kind }));
  }
  for (const cut of now.cuts) bar.append(drawn("line", { x1: cut - now.first, x2: cut - now.first, y1: 0, y2: 10 }));
  if (chosen) {
    const x = chosen.frame - now.first + 0.5;
    bar.append(drawn("line", { class: "now", x1: x, x2: x, y1: 0, y2: 10 }));
  }
  bar.addEventListener("click", (event) => {
    const box = bar.getBoundingClientRect();
    const at = Math.floor(((event.clientX - box.left) / box.width) * span);
    chosen = { name: person.name, frame: now.first + Math.min(Math.max(at, 0), span - 1) };
    render();
  });
  return make("div", { class: "row", "data-name": person.name }, draggable(make("span", {}, person.name), person.name), bar);
}

function showMoment() {
  $("moment").hidden = !chosen;
  if (!chosen) return;
  $("frame").src = `api/frame?frame=${chosen.frame}&reduce=2`;
  $("frame").alt = `Frame ${chosen.frame}`;
  $("where").textContent = `Frame ${chosen.frame}, ${clock(chosen.frame)}`;
  $("split").textContent = `From here ${chosen.name} is somebody else`;
  const track = now.tracks.find((one) => one.person === chosen.name && one.first <= chosen.frame && chosen.frame < one.stop);
  $("points").hidden = !HOME || !track;
  $("points").textContent = `Correct the points of ${chosen.name} in this shot`;
  $("points").onclick = () => openPoints(track);
}

/** The page that corrects the points of a track, if this page was opened from that of all clips. */
async function openPoints({ person, first }) {
  if (now.changes.length) return say("Save who is who first, or undo it.");
  const clip = Number(/people-([0-9]+)/.exec(location.pathname)[1]);
  try {
    const { url } = await api.post("../../api/open", { clip, page: "fix", person, frame: first });
    location.href = new URL(`../${url}`, document.baseURI);
  } catch (error) {
    say(error.message, "error");
  }
}

function showDoubt() {
  const open = now.doubts;
  $("doubts").hidden = !open.length;
  if (!open.length) return;
  doubt %= open.length;
  const track = open[doubt];
  const choices = [
    [track.person, track.p, track.person],
    ...(track.other ? [[track.other, track.p_other, track.other]] : []),
    ["somebody new", track.other ? null : track.p_other, null],
  ];
  const whole = `${doubt + 1} of ${open.length}: frames ${track.first} to ${track.stop - 1}, ${clock(track.first)}`;
  const figures = choices.map(([name, p, to], index) => {
    const known = to && now.people.some((one) => one.name === to);
    const face = known ? make("img", { src: still(longest(to)), alt: name }) : make("div", { class: "nobody" }, "?");
    const choose = make("button", { type: "button", click: () => settle(index) });
    choose.append(`${index + 1}: ${name}${p === null ? "" : `, P ${p.toFixed(2)}`}`);
    return make("figure", {}, face, choose);
  });
  const own = make("figure", {}, make("img", { src: still(track), alt: "the track in doubt" }), make("small", {}, whole));
  $("doubt").replaceChildren(own, ...figures);
  settle.choices = choices.map(([, , to]) => to);
  settle.track = track;
}

function settle(index) {
  const { choices, track } = settle;
  if (track && index < choices.length) change("give", track.person, { to: choices[index], frame: track.first });
}

function render() {
  $("film").textContent = `People in ${now.clip}`;
  $("people").replaceChildren(...[...now.people].sort((a, b) => b.seconds - a.seconds).map(card));
  $("timeline").replaceChildren(...now.people.map(row));
  showMoment();
  showDoubt();
  const busy = Boolean(now.job || now.ended);
  $("undo").disabled = busy || !now.changes.length;
  $("save").disabled = busy || !now.changes.length;
  $("done").disabled = busy;
  if (now.job) say(`${now.job.what}${now.job.total ? `, ${now.job.done} of ${now.job.total}` : ""}`);
  if (now.ended) say(now.ended.messages.join("; "));
  else if (now.message) say(now.message);
}

function show(state) {
  now = state;
  if (chosen && !now.people.some((one) => one.name === chosen.name)) chosen = null;
  render();
}

async function poll() {
  const before = now;
  try {
    const state = await api.state();
    // an answer that was on its way when something was changed is old
    if (now === before && JSON.stringify(state) !== JSON.stringify(now)) show(state);
  } catch (error) {
    if (now.ended) return;
    say(error.message, "error");
  }
  setTimeout(poll, POLL);
}

const step = (by) => {
  if (!chosen) return;
  chosen.frame = Math.min(Math.max(chosen.frame + by, now.first), now.last);
  render();
};
$("undo").addEventListener("click", () => ask("undo"));
$("save").addEventListener("click", () => ask("save"));
$("done").addEventListener("click", async () => {
  if (now.changes.length && !confirm(`${now.changes.length} changes are not saved, and would be gone. End?`)) return;
  await ask("done");
  if (HOME && now.ended) location.href = HOME;
});
showHome();
$("back").addEventListener("click", () => step(-1));
$("on").addEventListener("click", () => step(1));
$("split").addEventListener("click", () => change("split", chosen.name, { frame: chosen.frame }));
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /INPUT|SELECT/.test(event.target.tagName)) return;
  const does = {
    u: () => ask("undo"),
    s: () => ask("save"),
    n: () => ((doubt += 1), render()),
    ArrowLeft: () => step(-1),
    ArrowRight: () => step(1),
  };
  if (does[event.key]) does[event.key]();
  else if (/^[1-9]$/.test(event.key)) settle(Number(event.key) - 1);
});

show(await api.state());
poll();
