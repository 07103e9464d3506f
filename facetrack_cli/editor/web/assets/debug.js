// What tests look at: window.facetrack.

/** What tests and the curious may look at; nothing can be changed by it. */
export function debug({ store, stage, sync, mode }) {
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
        // of putting a run right
        view("rowsRevision", () => (mode.rows?.fresh(store.frame) ? mode.rows.revision : null)),
        view("rows", () => structuredClone(mode.rows?.frame(store.frame) ?? null)),
        view("job", () => structuredClone(sync.state.job)),
        view("busy", () => store.busy ?? false),
        view("looked", () => structuredClone(store.looked ?? null)),
        view("corrections", () => structuredClone(mode.corrections ?? null)),
        view("doubtful", () => mode.doubtful?.frames.map(({ frame }) => frame) ?? null),
        view("playing", () => mode.play?.on ?? false),
        view("canUndo", () => sync.state.can_undo),
      ]),
    ),
  );
}
