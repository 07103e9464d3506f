// What there is to place: the groups of the list, one a target, and what a target may be called.

const NAME = /^[A-Za-z_][A-Za-z0-9_-]{0,63}$/;
const KEYS = ["frame", "box", "points", "windows", "corrections", "kept", "absent", "learn"];

/** What is wrong with a name of a target or part; empty if nothing is. */
export function wrongName(name, taken) {
  if (!NAME.test(name)) return "A name has letters, digits, _ and -, and does not begin with a digit.";
  if (KEYS.includes(name)) return `“${name}” is a word of the file itself; choose another.`;
  return taken.includes(name) ? `There is a ${name} already.` : "";
}

/** The groups of the list: what is wanted, and what the draft has beside it. */
export function arranged(session, draft) {
  const { wants, free } = session;
  let groups = wants.map((want) => group(want.target, want));
  const names = Object.keys(draft.targets);
  const strange = names.filter((name) => !wants.some((want) => want.target === name));
  // where names are free, what is wanted goes by the names that there are
  if (free && strange.length) groups = groups.filter(({ target }) => names.includes(target));
  groups.push(...strange.map((name) => stranger(session, name)));
  for (const one of groups) {
    const more = Object.keys(draft.targets[one.target]?.points ?? {}).filter((part) => !one.points.includes(part));
    one.points.push(...more);
    one.extra.push(...more);
  }
  return groups;
}

/** A target of the user's own; it wants what any target does, where names are free. */
export function stranger({ wants, free }, target) {
  const like = free && wants.length ? wants[0] : { box: "optional", points: [], about: {} };
  return { ...group(target, like), added: true };
}

const group = (target, { box, points, about }) => ({
  target,
  box,
  points: [...points],
  about,
  extra: [],
  added: false,
});
