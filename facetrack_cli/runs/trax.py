"""TraX, the protocol of the VOT challenge (github.com/votchallenge/trax, docs/protocol.rst): we are its server.

Messages are lines: `@@TRAX:name "argument" ... "key=value" ...`; other lines mean nothing. We say `hello`; the client
sends `initialize` with an image and a region, or `frame` with an image, and we answer with the `state`; `quit` ends it.
Spoken is version 3, which a client of version 4 takes too. Images are paths, regions rectangles (left, top, width,
height in pixels from 0, as in VOT's text files) or polygons, of which the upright box around them is taken. A face
under affine maps answers with its parallelogram.
"""

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.core.errors import FacetrackError, InputError, UsageError, flat
from facetrack_cli.core.types import Box, Image, Start, TargetStart
from facetrack_cli.recipe.files import default_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import track_frames
from facetrack_cli.trajectory.reader import MAX_PIXELS
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.video import images

PREFIX: Final = "@@TRAX:"
VERSION: Final = 3
ARGUMENTS: Final = {"initialize": 2, "frame": 1, "quit": 0}  # that a message of the client must have
_KEY = re.compile(r"[A-Za-z0-9._]{1,64}=")
_ARGUMENT = re.compile(r'\s*(?:"((?:[^"\\]|\\.)*)"|([^\s"]+))(?=\s|$)')


class Message(NamedTuple):
    """A message of the protocol: `given` are its arguments in order, `named` those of a key and a value."""

    name: str
    given: tuple[str, ...] = ()
    named: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        """Its line, without the end."""
        texts = [*self.given, *(f"{key}={value}" for key, value in self.named)]
        escaped = (text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") for text in texts)
        return " ".join([PREFIX + self.name, *(f'"{text}"' for text in escaped)])


def parse(line: str) -> Message | None:
    """The message of a line; None for a line of another kind. InputError for one that cannot be understood."""
    if not line.startswith(PREFIX):
        return None
    name, _, rest = line[len(PREFIX) :].rstrip().partition(" ")
    if name not in ARGUMENTS:
        raise InputError(f"TraX: no message {name!r} of a client is known; there are {', '.join(ARGUMENTS)}")
    texts, at = [], 0
    while rest[at:].strip():
        found = _ARGUMENT.match(rest, at)
        if found is None:
            raise InputError(f"TraX: {name}: the arguments {flat(rest[:200])} cannot be told apart; quote them")
        texts.append(found[2] if found[1] is None else re.sub(r"\\(.)", _unescaped, found[1]))
        at = found.end()
    count = ARGUMENTS[name]
    if len(texts) < count or not all(_KEY.match(text) for text in texts[count:]):
        raise InputError(
            f"TraX: {name} has {count} argument{'s' * (count != 1)} and then key=value; it is {flat(line)}"
        )
    named = [text.partition("=") for text in texts[count:]]
    return Message(name, tuple(texts[:count]), tuple((key, value) for key, _, value in named))


def serve(lines: Iterable[str], write: Callable[[str], None], recipe: Recipe) -> None:
    """Answer the client whose messages are `lines`, until it quits or ends; `write` takes ours, without line ends.

    UsageError for a recipe without a box to answer with. What goes wrong is raised, after a `quit` that says why.
    """
    if recipe.points or len(recipe.followed) > 1:
        follows, other = "points" if recipe.points else "several targets", default_recipe(box=True)
        raise UsageError(f"TraX follows one box, and {recipe.name} {follows}; take a recipe of a box, as {other}")
    about = {"version": VERSION, "name": "facetrack", "identifier": f"{recipe.name} {__version__}"}
    about |= {"image": "path;", "region": "rectangle;polygon;", "channels": "color;"}
    write(str(Message("hello", named=tuple((f"trax.{key}", str(value)) for key, value in about.items()))))
    waiting = deque[Path]()
    results: Iterator[FrameResult] | None = None
    try:
        for message in filter(None, map(parse, lines)):
            if message.name == "quit":
                return
            waiting.append(image_of(message.given[0]))
            if message.name == "initialize":
                start = Start(0, {"face": TargetStart(box=box_of(message.given[1]))}, "TraX")
                results = track_frames(_images(waiting), recipe, init=start)
            if results is None:
                raise InputError("TraX: a frame before initialize says where the target is")
            write(str(state(next(results))))
    except FacetrackError as e:
        write(str(Message("quit", named=(("trax.reason", flat(str(e))),))))
        raise


def state(result: FrameResult) -> Message:
    """The answer: the place of the target, and how sure the tracker is where it says so."""
    rows = result.rows
    (ltwh,), corners = rows.boxes.tolist(), None if rows.corners is None else rows.corners[0]
    outline = corners is not None and bool(np.isfinite(corners).all())
    values = corners.ravel().tolist() if corners is not None and outline else ltwh
    confidence = float(rows.confidence[0])
    named = (("confidence", f"{confidence:.4f}"),) if np.isfinite(confidence) else ()
    return Message("state", (",".join(f"{value:.4f}" for value in values),), named)


def box_of(region: str) -> Box:
    """Left, top, width and height of a region. InputError for a mask, and for what is no region."""
    if region[:1] in ("m", "M"):
        raise InputError("TraX: a mask; masks are not read: give the region as a rectangle or a polygon")
    try:
        values = [float(value) for value in region.split(",")]
    except ValueError:
        values = []
    if len(values) >= 6 and len(values) % 2 == 0:
        x, y = values[::2], values[1::2]
        values = [min(x), min(y), max(x) - min(x), max(y) - min(y)]
    if len(values) != 4 or not all(abs(value) <= MAX_PIXELS for value in values) or min(values[2:]) <= 0:
        raise InputError(
            f"TraX: {flat(region[:200])!r} is no rectangle left,top,width,height and no polygon x,y,x,y,x,y"
        )
    left, top, width, height = values
    return left, top, width, height


def image_of(address: str) -> Path:
    """The file that an image message names. InputError for images that are no files."""
    if address.startswith("file://"):
        return Path(address.removeprefix("file://"))
    if re.match(r"(image|data|https?|ftp):", address):
        raise InputError(f"TraX: the image {flat(address[:60])!r} is no path; hello says that paths are read")
    return Path(address)


def _images(waiting: deque[Path]) -> Iterator[Image]:
    while waiting:
        yield images.read(waiting.popleft())


def _unescaped(found: re.Match[str]) -> str:
    return "\n" if found[1] == "n" else found[1]
