// window.facetrack: what tests, and anybody in the console, may look at; nothing can be changed by it.

export function debug({ store, stage, sync, mode }) {
  const views = {
    draft: () => store.draft,
    frame: () => store.frame,
    image: () => (stage.image ? { index: stage.image.index, reduce: stage.image.reduce } : null),
    zoom: () => stage.zoom,
    mode: () => store.mode,
    current: () => store.current,
    selected: () => store.selected,
    proposals: () => store.proposals,
    sent: () => !sync.dirty && !sync.sending,
    ended: () => store.ended,
    busy: () => store.busy,
    // of correcting a run
    rowsRevision: () => (mode.rows?.isCurrent(store.frame) ? mode.rows.revision : null),
    rows: () => mode.rows?.frame(store.frame) ?? null,
    job: () => sync.state.job,
    highlighted: () => store.highlighted ?? null,
    corrections: () => mode.corrections ?? null,
    review: () => mode.review?.frames.map(({ frame }) => frame) ?? null,
    canUndo: () => sync.state.can_undo,
    saves: () => sync.state.saves ?? null,
  };
  const found = {
    /** From pixels of the frame to CSS pixels of the window, [x, y]. */
    toScreen: (x, y) => {
      const { left, top } = stage.canvas.getBoundingClientRect();
      const [sx, sy] = stage.toCanvas(x, y);
      return [sx + left, sy + top];
    },
  };
  for (const [name, view] of Object.entries(views)) {
    Object.defineProperty(found, name, { get: () => structuredClone(view()), enumerable: true });
  }
  return Object.freeze(found);
}
