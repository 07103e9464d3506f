// The page of a project: a line for each clip, and what can be done with it.

import * as api from "./api.js";
import { $, button, make, plural, readable, say, setText } from "./dom.js";
import { Look } from "./look.js";
import { upload } from "./upload.js";

const POLL = 1000; // ms
const WHAT = { face: "A face", everybody: "Everybody", signer: "A signer", box: "A box I draw" };
const STATES = {
  ready: "",
  "needs box": "Draw the box first",
  queued: "Waits for its turn",
  paused: "Paused",
  interrupted: "Stopped",
  done: "Done",
  failed: "Failed",
};
const rows = new Map(); // id -> the parts of a line
let now = null; // the state that the server told last
let over = false;

const clock = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
function duration(s) {
  if (s < 60) return `${Math.max(Math.round(s), 1)} s`;
  return s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`;
}

/** The server's answer, null if it refused, which is shown. */
async function ask(path, body = {}) {
  try {
    const found = await api.post(path, body);
    if (found?.clips) show(found);
    return found;
  } catch (error) {
    say(error.message, "error");
    return null;
  }
}

async function open(clip, page) {
  const of = page === "correct" ? (clip.what === "everybody" ? "people" : "fix") : page;
  const found = await ask("open", { clip: clip.id, page: of });
  if (found) location.href = found.url;
}

function again(clip) {
  const text = "The results that are there now are replaced, with what was corrected in them.";
  if (confirm(`Track ${clip.name} from the start?\n\n${text}`)) ask("want", { clips: [clip.id], wanted: true, again: true });
}

function remove(clip) {
  const text = "Its results stay in the folder “runs”. The clip itself stays where it is.";
  if (confirm(`Remove ${clip.name} from the list?\n\n${text}`)) ask("remove", { clip: clip.id });
}

/** The files of programs, as a menu; the browser saves what is chosen. */
export function exportMenu(menu, title, programs, address) {
  const options = programs.map(([name, one]) => make("option", { value: name }, one.name));
  menu.replaceChildren(make("option", { value: "" }, title), ...options);
  menu.onchange = async () => {
    const program = menu.value;
    menu.value = "";
    say("Writing the file …");
    try {
      const [blob, headers] = await api.file(`${address}&program=${program}`);
      const name = /filename="([^"]*)"/.exec(headers.get("Content-Disposition"))[1];
      const link = make("a", { href: URL.createObjectURL(blob), download: name });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
      say(`Saved; a copy is in ${now.folder}/exports.`);
    } catch (error) {
      say(error.message, "error");
    }
  };
}

// --- a line

function line(id) {
  const find = () => now.clips.find((one) => one.id === id);
  const act = (does) => () => does(find());
  const named = (name, text, does, more = {}) =>
    button(`${name}-${id}`, { class: `small ${name}`, click: act(does), ...more }, text);
  const picture = make("img", { src: "data:,", alt: "", loading: "lazy", width: 96, height: 64 });
  const name = make("span", { class: "name" });
  const about = make("span", { class: "quiet" });
  const what = make("select", { "data-testid": `what-${id}` });
  what.addEventListener("change", () => ask("choose", { clips: [id], what: what.value }));
  const state = make("p", { class: "state", "data-testid": `state-${id}` });
  const bar = make("progress", { max: 1 });
  const menu = make("select", { "data-testid": `export-${id}`, class: "small" });
  exportMenu(menu, "Export …", Object.entries(now.programs), `export?clip=${id}`);
  const actions = {
    run: named("run", "Track", (clip) => ask("want", { clips: [clip.id], wanted: true })),
    start: named("start", "", (clip) => open(clip, "start")),
    stop: named("stop", "Stop", (clip) => ask("want", { clips: [clip.id], wanted: false })),
    look: named("look", "Look", (clip) => (location.hash = `look-${clip.id}`)),
    correct: named("correct", "Correct", (clip) => open(clip, "correct")),
    again: named("again", "Track again", again),
    remove: named("remove", "Remove", remove),
  };
  const { look, correct, run, start, stop, ...last } = actions;
  const buttons = make("div", { class: "buttons" }, run, look, correct, menu, stop, start, ...Object.values(last));
  const body = make("div", { class: "about" }, name, about);
  const item = make("li", { "data-testid": `clip-${id}` }, picture, body, what, make("div", { class: "how" }, state, bar), buttons);
  return { item, picture, name, about, what, state, bar, menu, ...actions };
}

function showLine(row, clip) {
  const { state } = clip;
  row.item.dataset.state = state;
  setText(row.name, clip.name);
  row.name.title = clip.path;
  const size = clip.size ? `${clock(clip.seconds)}, ${clip.size.join(" × ")}` : clip.error ? "" : "looking at it …";
  setText(row.about, size);
  if (clip.size && row.picture.getAttribute("src") === "data:,") row.picture.src = `api/thumb?clip=${clip.id}`;
  const active = ["queued", "running", "paused"].includes(state);
  const made = ["done", "interrupted"].includes(state);
  row.what.disabled = active || !clip.size;
  row.what.setAttribute("aria-label", `What to track in ${clip.name}`);
  if (row.likely !== clip.likely || !row.what.length) {
    const of = ([value, text]) => make("option", { value }, value === clip.likely ? `${text} (likely)` : text);
    row.what.replaceChildren(...Object.entries(WHAT).map(of));
    row.likely = clip.likely;
  }
  if (document.activeElement !== row.what) row.what.value = clip.what;
  setText(row.state, describe(clip));
  row.bar.hidden = state !== "running";
  if (clip.done && clip.frames) row.bar.value = Math.min(clip.done / clip.frames, 1);
  else row.bar.removeAttribute("value");
  row.run.hidden = !["ready", "interrupted", "failed"].includes(state) || !clip.size;
  setText(row.run, state === "interrupted" ? "Go on" : state === "failed" ? "Try again" : "Track");
  row.stop.hidden = !active;
  setText(row.stop, state === "running" ? "Stop" : "Not now");
  row.look.hidden = row.menu.hidden = !made || !clip.done;
  row.correct.hidden = state !== "done";
  row.start.hidden = active || !clip.size || clip.what === "everybody";
  setText(row.start, clip.what === "box" ? (clip.start ? "Draw the box anew" : "Draw the box") : "Choose the start");
  row.start.classList.toggle("primary", state === "needs box");
  row.again.hidden = !made;
  row.remove.hidden = active;
  for (const one of [row.run, row.stop, row.look, row.correct, row.menu, row.start, row.again, row.remove])
    one.setAttribute("aria-label", `${one.textContent.split("…")[0].trim()}: ${clip.name}`);
}

function describe(clip) {
  const { state, done, frames, rate } = clip;
  if (state === "failed") return `Failed: ${clip.error}`;
  if (state === "done") return clip.look ? `Done. Look at: ${readable(clip.look)}` : "Done";
  if (state === "interrupted") return `Stopped after ${plural(done, "frame")}, which are kept`;
  if (state !== "running") return STATES[state];
  if (!done) return `${readable(clip.doing || "starting").replace(/^./, (c) => c.toUpperCase())} …`;
  const left = rate ? `, about ${duration(Math.max(frames - done, 0) / rate)} left` : "";
  return `${done} of ${frames} frames${left}`;
}

// --- all

function show(state) {
  now = state;
  setText($("folder"), state.folder.split(/[\\/]/).at(-1));
  $("folder").title = state.folder;
  for (const [id, row] of rows) {
    if (state.clips.some((one) => one.id === id)) continue;
    row.item.remove();
    rows.delete(id);
  }
  for (const clip of state.clips) {
    if (!rows.has(clip.id)) {
      rows.set(clip.id, line(clip.id));
      $("clips").append(rows.get(clip.id).item);
    }
    showLine(rows.get(clip.id), clip);
  }
  const count = (...states) => state.clips.filter((one) => states.includes(one.state)).length;
  const ready = state.clips.filter((one) => one.size && ["ready", "interrupted"].includes(one.state));
  const [done, waiting] = [count("done"), count("queued", "running", "paused")];
  document.body.classList.toggle("empty", !state.clips.length);
  $("work").hidden = !state.clips.length;
  const rate = state.clips.find((one) => one.rate)?.rate;
  const sum = (key, ...states) =>
    state.clips.reduce((total, one) => total + (states.includes(one.state) ? Math.min(one[key], one.frames) : 0), 0);
  const frames = sum("frames", "queued", "running") - sum("done", "queued", "running");
  const left = rate ? `about ${duration(frames / rate)} left` : "";
  const failed = count("failed");
  const told = [`${done} of ${plural(state.clips.length, "clip")} done`, failed && `${failed} failed`, state.paused && waiting && "paused", left];
  setText($("overall-text"), told.filter(Boolean).join(", "));
  $("overall-bar").hidden = !waiting;
  const all = ["queued", "running", "paused", "done"];
  $("overall-bar").value = sum("done", ...all) / Math.max(sum("frames", ...all), 1);
  $("run-all").hidden = !ready.length;
  setText($("run-all"), ready.length === 1 ? "Track 1 clip" : `Track all ${ready.length}`);
  $("run-all").onclick = () => ask("want", { clips: ready.map((one) => one.id), wanted: true });
  $("pause").hidden = !waiting;
  $("pause").classList.toggle("primary", state.paused);
  $("run-all").classList.toggle("primary", !(state.paused && waiting));
  setText($("pause"), state.paused ? "Go on" : "Pause");
  $("pause").onclick = () => ask("pause", { paused: !now.paused });
  const open = state.clips.filter((one) => one.size && ["ready", "needs box"].includes(one.state));
  $("same").hidden = open.length < 2;
  $("export-all").hidden = !done;
  look.update(state);
}

async function poll() {
  try {
    const state = await api.state();
    if (state.ended) return ended();
    if (over) return;
    $("offline").hidden = true;
    show(state);
  } catch (error) {
    if (over) return;
    if (!(error instanceof api.Failed)) throw error;
    $("offline").hidden = false;
  }
  setTimeout(poll, POLL);
}

function ended() {
  over = true;
  document.body.replaceChildren(make("p", { class: "ended", "data-testid": "ended" }, "facetrack has ended; you may close this page."));
}

async function quit() {
  const active = now.clips.some((one) => one.state === "running");
  const text = active ? "What is tracked now is kept; it goes on when facetrack is started again." : "All is kept. Start facetrack again to go on.";
  if (confirm(`Quit facetrack?\n\n${text}`)) {
    await ask("quit");
    ended();
  }
}

function drops() {
  const zone = document.body;
  let depth = 0;
  const over = (by) => (depth = by === 0 ? 0 : depth + by, zone.classList.toggle("dropping", depth > 0));
  zone.addEventListener("dragenter", () => over(1));
  zone.addEventListener("dragleave", () => over(-1));
  zone.addEventListener("dragover", (event) => event.preventDefault());
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    over(0);
    upload([...event.dataTransfer.files]);
  });
}

const look = new Look({ open, exportMenu, back: () => (location.hash = "") });
const hash = () => look.show(Number(/^#look-([0-9]+)$/.exec(location.hash)?.[1] ?? 0), now);

async function start() {
  show(await api.state());
  $("quit").addEventListener("click", quit);
  $("files").addEventListener("change", () => {
    upload([...$("files").files]);
    $("files").value = "";
  });
  $("by-path").addEventListener("submit", async (event) => {
    event.preventDefault();
    const found = await ask("add", { path: $("path").value });
    if (!found) return;
    say(found.added.length ? `${plural(found.added.length, "clip")} added.` : "They are in the list already.");
    $("path").value = "";
  });
  const all = Object.entries(WHAT).filter(([name]) => name !== "box");
  $("same").append(make("option", { value: "" }, "In all new clips …"), ...all.map(([value, text]) => make("option", { value }, text)));
  $("same").addEventListener("change", () => {
    const open = now.clips.filter((one) => one.size && ["ready", "needs box"].includes(one.state));
    ask("choose", { clips: open.map((one) => one.id), what: $("same").value });
    $("same").value = "";
  });
  exportMenu($("export-all"), "Export all …", Object.entries(now.programs).filter(([, one]) => one.many), "export?");
  drops();
  window.addEventListener("hashchange", hash);
  hash();
  document.body.classList.add("ready");
  setTimeout(poll, POLL);
}

start().catch((error) => {
  $("offline").hidden = false;
  if (!(error instanceof api.Failed)) throw error;
});
