// What tests look at: window.facetrack.

/** What tests and the curious may look at; nothing can be changed by it. */
export function debug({ store, stage, sync }) {
  const view = (name, get) => [name, { get, enumerable: true }];
  const shifted = (x, y, sign) => {
    const { left, top } = stage.canvas.getBoundingClientRect();
    return [x + sign * left, y + sign * top];
  };
  return Object.freeze(
    Object.defineProperties(
      {
        /** From pixels of the picture to CSS pixels of the window, [x, y]. */
        toScreen: (x, y) => shifted(...stage.place(x, y), 1),
        /** From CSS pixels of the window to pixels of the picture, [x, y]. */
        toPicture: (x, y) => stage.spot(...shifted(x, y, -1)),
      },
      Object.fromEntries([
        view("draft", () => structuredClone(store.draft)),
        view("frame", () => store.frame),
        view("picture", () => (stage.picture ? { index: stage.picture.index, reduce: stage.picture.reduce } : null)),
        view("zoom", () => stage.zoom),
        view("mode", () => store.mode),
        view("current", () => structuredClone(store.current)),
        view("selected", () => structuredClone(store.selected)),
        view("proposals", () => structuredClone(store.proposals)),
        view("revision", () => sync.revision),
        view("sent", () => !sync.dirty && !sync.running),
        view("gone", () => sync.gone),
        view("ended", () => store.ended),
      ]),
    ),
  );
}
