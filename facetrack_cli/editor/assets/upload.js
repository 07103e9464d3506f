// Files that are dropped, sent piece by piece: a piece that is lost is sent again.

import * as api from "./api.js";
import { $, make, say, setText } from "./dom.js";

const PIECE = 512 * 1024; // bytes
const TRIES = 4;
let queue = Promise.resolve();

/** One file after another; a line for each while it is sent. */
export function upload(files) {
  for (const file of files) {
    const bar = make("progress", { max: Math.max(file.size, 1), value: 0 });
    const text = make("span", {}, file.name);
    const item = make("li", {}, text, bar);
    $("uploads").append(item);
    queue = queue
      .then(() => send(file, bar))
      .then(() => item.remove())
      .catch((error) => {
        bar.remove();
        setText(text, `${file.name}: ${error.message}`);
        item.classList.add("bad");
        say(`${file.name}: ${error.message}`, "error");
        setTimeout(() => item.remove(), 20_000);
      });
  }
}

async function send(file, bar) {
  if (!file.size) throw new Error("is empty, or a folder; name the path of a folder below");
  for (let offset = 0; offset < file.size; offset += PIECE) {
    const query = new URLSearchParams({ name: file.name, offset, total: file.size });
    for (let n = 1; ; n++) {
      const failed = await api.putPiece(query, file.slice(offset, offset + PIECE)).catch((error) => error);
      if (!(failed instanceof Error)) break;
      if (failed.status || n === TRIES) throw failed;
      await new Promise((resolve) => setTimeout(resolve, 1000 * n));
    }
    bar.value = Math.min(offset + PIECE, file.size);
  }
}
