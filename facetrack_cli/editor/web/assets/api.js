// The server's addresses. All are relative to the page, so the token and a tunnel's port take care of themselves.

const BASE = new URL("api/", document.baseURI);
const PATIENCE = 20_000; // ms: a long clip may have to be read up to a frame

/** The server said no: `status` is its code, `body` what it said. */
export class Refused extends Error {
  constructor(status, body) {
    super(body?.error ?? `the server answered ${status}`);
    this.status = status;
    this.body = body;
  }
}

/** Nobody answers at this address any more. */
export class Gone extends Error {}

async function ask(path, { method = "GET", body, signal } = {}) {
  const patience = AbortSignal.timeout(PATIENCE);
  const options = { method, cache: "no-store", signal: signal ? either(signal, patience) : patience };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
    options.headers = { "Content-Type": "application/json" };
  }
  let answer;
  try {
    answer = await fetch(new URL(path, BASE), options);
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new Gone("the server does not answer");
  }
  if (answer.ok) return answer;
  throw new Refused(answer.status, await answer.json().catch(() => null));
}

// AbortSignal.any is missing from tablets of a few years ago
function either(first, second) {
  const both = new AbortController();
  for (const signal of [first, second]) {
    if (signal.aborted) both.abort(signal.reason);
    signal.addEventListener("abort", () => both.abort(signal.reason), { once: true });
  }
  return both.signal;
}

async function json(path, options) {
  const answer = await ask(path, options);
  try {
    return await answer.json();
  } catch {
    throw new Gone("the server stopped in the middle of an answer");
  }
}

async function blob(path, signal) {
  const answer = await ask(path, { signal });
  try {
    return await answer.blob();
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new Gone("the server stopped in the middle of a picture");
  }
}

export const session = () => json("session");
export const state = () => json("state");
export const proposals = (frame, signal) => json(`proposals/${frame}`, { signal });
export const putDraft = (base, draft) => json("draft", { method: "PUT", body: { base, draft } });
export const post = (what, body) => json(what, { method: "POST", body });
export const get = (path, signal) => json(path, { signal });
export const picture = (frame, reduce, signal) => blob(`frame/${frame}.jpg?reduce=${reduce}`, signal);
export const crop = (frame, x, y, w, h) => blob(`crop/${frame}.png?x=${x}&y=${y}&w=${w}&h=${h}`);
