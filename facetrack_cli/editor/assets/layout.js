// What is to be placed: the groups of the list, one for each target, and which names are allowed.

const NAME = /^[A-Za-z_][A-Za-z0-9_-]{0,63}$/;

/** What is wrong with a name of a target; empty if nothing is. */
export function wrongName(name, taken) {
  if (!NAME.test(name)) return "A name has letters, digits, _ and -, and does not begin with a digit.";
  return taken.includes(name) ? `There is already a target ${name}.` : "";
}

/** The groups of the list: what is required, and what the draft has besides. */
export function groupsOf(session, draft) {
  const { requirements, free } = session;
  let groups = requirements.map((one) => group(one.target, one));
  const names = Object.keys(draft.targets);
  const others = names.filter((name) => !requirements.some((one) => one.target === name));
  // where names are free, the requirements apply to the names that there are
  if (free && others.length) groups = groups.filter(({ target }) => names.includes(target));
  groups.push(...others.map((name) => addedGroup(session, name)));
  for (const one of groups) {
    const more = Object.keys(draft.targets[one.target]?.points ?? {}).filter((part) => !one.points.includes(part));
    one.points.push(...more);
    one.extra.push(...more);
  }
  return groups;
}

/** The group of a target that the user added; it requires the same as any target, where names are free. */
export function addedGroup({ requirements, free }, target) {
  const like = free && requirements.length ? requirements[0] : { box: "optional", points: [], about: {} };
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
