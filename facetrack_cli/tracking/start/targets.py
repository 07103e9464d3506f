"""From a start to the targets that a recipe names: a head, and hands.

The first target of the recipe is the head, and its box is needed: a face that was found, `--box`, an init file. Other
targets that are not given begin as the largest regions of the head's skin colour beside the face, named from left to
right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.tracking.models.skin_colour import learn_skin
from facetrack_cli.tracking.start.checks import LEAST_BOX, check_size
from facetrack_cli.tracking.start.haar import NotHereError
from facetrack_cli.tracking.start.init_file import TARGET
from facetrack_cli.tracking.start.skin_regions import hand_regions


def name_targets(
    start: Start, names: Sequence[str], frame: Frame | None, *, left_out: Sequence[str] = (), clip: str = "the clip"
) -> Start:
    """The start with all targets `names`, in their order; without names, as it is.

    A single target, or one called `face`, takes the first name if the recipe does not know its own; so do its
    corrections. Targets in `left_out` are dropped. `frame` is the start's, and may be None if no target is missing.
    Raises InputError if there are targets that the recipe does not know, the first one is missing, or the frame is
    grey; NotHereError if there are not as many regions of skin as hands.
    """
    if not names:
        return start
    given = {name: target for name, target in start.targets.items() if name not in left_out}
    corrections = [one for one in start.corrections if one.target not in left_out]
    sole = len(given) == 1 and not set(given) & set(names)
    head_as = next(iter(given)) if sole else TARGET
    if names[0] not in given and head_as in given:
        given[names[0]] = given.pop(head_as)
        corrections = [replace(one, target=names[0]) if one.target == head_as else one for one in corrections]
    known = ", ".join(names)
    strangers = [name for name in given if name not in names]
    if strangers:
        raise InputError(
            f"{start.origin}: has {', '.join(strangers)}, which the recipe does not know; it follows {known}: "
            "rename them in the init file, or in the recipe"
        )
    head = given[names[0]].box if names[0] in given else None
    if head is None:
        raise InputError(
            f"{start.origin}: has no box of {names[0]}, which the recipe begins with; it follows {known}: "
            f"add one, as in {names[0]}: {{box: [x, y, w, h]}}, or look for a face with --init haar"
        )
    check_size(start.origin, names[0], head)
    missing = [name for name in names if name not in given]
    if missing:
        assert frame is not None
        taken = [one.box for name, one in given.items() if name != names[0] and one.box is not None]
        try:
            found = hand_regions(frame, head, learn_skin(frame, head), len(missing), taken, LEAST_BOX)
        except InputError as e:
            raise InputError(f"{clip}: {names[0]}, {e}") from None
        if len(found) < len(missing):
            number = {0: "no region", 1: "one region"}.get(len(found), f"{len(found)} regions")
            remedy = f"begin elsewhere with --init-frame, or follow fewer, as by --set targets.{missing[-1]}=null"
            raise NotHereError(
                f"{clip}: frame {start.frame} shows {number} of skin beside the {names[0]}, to begin "
                f"{' and '.join(missing)} with; give their boxes in an init file, {remedy}"
            )
        given |= {name: TargetStart(box=box) for name, box in zip(missing, found, strict=True)}
    return replace(start, targets={name: given[name] for name in names}, corrections=tuple(corrections))
