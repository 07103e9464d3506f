// A question before what cannot be taken back.

import { $, write } from "./dom.js";

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
