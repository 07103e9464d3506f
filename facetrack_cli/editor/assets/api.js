// Requests to the server. Addresses are relative to the page, which has the token and the port of a tunnel.

const BASE = new URL("api/", document.baseURI);
const TIMEOUT = 20_000; // ms: a long clip may have to be read up to a frame

/** The server refused, with this `status`; or there is no answer from this address any more, status 0. */
export class Failed extends Error {
  constructor(message, status = 0) {
    super(message);
    this.status = status;
  }
}

/** The answer, read by `read`: a Response to a value. Throws Failed. */
async function request(path, read, { method = "GET", body, signal, atMost = TIMEOUT } = {}) {
  const signals = [AbortSignal.timeout(atMost), ...(signal ? [signal] : [])];
  const options = { method, body, cache: "no-store", signal: AbortSignal.any(signals) };
  let answer;
  try {
    answer = await fetch(new URL(path, BASE), options);
    if (answer.ok) return await read(answer);
  } catch (error) {
    throw signal?.aborted ? error : new Failed("facetrack does not answer");
  }
  const told = await answer.json().catch(() => null);
  throw new Failed(told?.error ?? `refused: ${answer.status}`, answer.status);
}

const json = (path, options) => request(path, (answer) => answer.json(), options);

export const session = () => json("session");
export const state = () => json("state");
export const proposals = (frame) => json(`proposals?frame=${frame}`);
export const rows = (first, last) => json(`rows?first=${first}&last=${last}`);
export const look = (clip) => json(`look?clip=${clip}`);
export const overview = (bins) => json(`overview?bins=${bins}`);
export const putPiece = (query, body) => json(`upload?${query}`, { method: "PUT", body });
export const post = (path, body = {}) => json(path, { method: "POST", body: JSON.stringify(body) });
export const file = (path) => request(path, (answer) => answer.blob().then((blob) => [blob, answer.headers]), { atMost: 1e7 });
export const image = (path, signal) => request(path, (answer) => answer.blob(), { signal });
