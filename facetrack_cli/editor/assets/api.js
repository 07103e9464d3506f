// Requests to the server. Addresses are relative to the page, which has the token and the port of a tunnel.

const BASE = new URL("api/", document.baseURI);
const TIMEOUT = 20_000; // ms: a long clip may have to be read up to a frame

/** The server refused: `status` is the code, `body` the answer. */
export class Refused extends Error {
  constructor(status, body) {
    super(body?.error ?? `the server answered ${status}`);
    this.status = status;
    this.body = body;
  }
}

/** There is no answer from this address any more. */
export class Unreachable extends Error {}

/** The answer, read by `read`: a Response to a value. */
async function request(path, read, { method = "GET", body, signal } = {}) {
  const timeout = AbortSignal.timeout(TIMEOUT);
  const options = { method, cache: "no-store", signal: signal ? either(signal, timeout) : timeout };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
    options.headers = { "Content-Type": "application/json" };
  }
  try {
    const answer = await fetch(new URL(path, BASE), options);
    if (answer.ok) return await read(answer);
    throw new Refused(answer.status, await answer.json().catch(() => null));
  } catch (error) {
    if (error instanceof Refused || signal?.aborted) throw error;
    throw new Unreachable("the server does not answer");
  }
}

// AbortSignal.any is missing in tablets of a few years ago
function either(first, second) {
  const both = new AbortController();
  for (const signal of [first, second]) {
    if (signal.aborted) both.abort(signal.reason);
    signal.addEventListener("abort", () => both.abort(signal.reason), { once: true });
  }
  return both.signal;
}

const json = (path, options) => request(path, (answer) => answer.json(), options);
const blob = (path, signal) => request(path, (answer) => answer.blob(), { signal });

export const session = () => json("session");
export const state = () => json("state");
export const proposals = (frame) => json(`proposals/${frame}`);
export const rows = (first, last) => json(`rows?first=${first}&last=${last}`);
export const look = (clip) => json(`look/${clip}`);
export const overview = (bins) => json(`overview?bins=${bins}`);
export const putDraft = (base, draft) => json("draft", { method: "PUT", body: { base, draft } });
export const post = (path, body) => json(path, { method: "POST", body });
export const frameImage = (frame, reduce, signal) => blob(`frame/${frame}.jpg?reduce=${reduce}`, signal);
export const crop = (frame, x, y, w, h) => blob(`crop/${frame}.png?x=${x}&y=${y}&w=${w}&h=${h}`);
