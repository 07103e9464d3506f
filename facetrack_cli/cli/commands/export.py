"""facetrack export: a trajectory as other tools read it."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import flag, option, say
from facetrack_cli.cli.types import FILE, FILE_OR_DASH, TRAJECTORY
from facetrack_cli.core.errors import InputError, OutputError, UsageError
from facetrack_cli.trajectory.formats import ALIASES, EXPORTS, OF_BOXES, OF_MEDIA

if TYPE_CHECKING:
    from facetrack_cli.trajectory.formats.tables import Clip
    from facetrack_cli.trajectory.select import Around


@click.command()
@click.argument("trajectory", type=TRAJECTORY)
@option("--to", type=click.Choice([*EXPORTS, *ALIASES]), metavar="FORMAT", required=True, help="Format, as above.")
@option("-o", "--out", type=FILE_OR_DASH, help="File to write [default: beside TRAJECTORY]; - standard output.")
@options.target
@option("--media", type=FILE, help=f"Clip it was tracked in ({', '.join(OF_MEDIA)}).")
@option("--into", type=FILE, help="An .eaf to add the tiers to.")
@option(
    "--box", type=click.Choice(["windows", "points"]), metavar="KIND",
    help="What a box around points encloses: windows [default], or points, their centres alone.",
)  # fmt: skip
@flag("--drop-lost", help="Write lost rows as not known, not with the estimate.")
@options.overwrite
def command(
    trajectory: Path, to: str, out: str | None, target: str | None, media: Path | None, into: Path | None,
    box: Around | None, drop_lost: bool, overwrite: bool,
) -> None:  # fmt: skip
    """Write a trajectory as other tools read it.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run; for measures, events and boris also that of
    many runs. The file goes beside it, with the ending of its format, unless -o says otherwise.

    \b
    Formats:
      FORMATS

    In mot, otb, got10k, vot and coco, a target of several points has the box around the windows that the tracker
    compares; with --box points, around the points alone.

    Lost rows hold the tracker's estimate. mot, coco and dlc give its confidence, coco also the visibility 1 (2 is
    tracked). With --drop-lost they are as if nothing was found: no row in mot, no keypoint in coco, an empty cell in
    dlc and csv-wide, nan in otb, zeros in got10k, a failure in vot.

    cvat and labelstudio go to the annotation tool, and what is corrected there comes back by facetrack fix --import.
    A lost row is occluded in cvat, and not enabled in labelstudio; with --drop-lost it is outside in cvat, too.

    eaf has tiers for lost parts, motion to the left, right, up and down, tilt, size, nods and shakes, as seen in the
    image plane; for open mouths, blinks and nods of the pose. It needs the video; coco and openface's pose_T the size
    of the frames: both stand in a trajectory.json, else give --media.

    With --into an .eaf that is there gets these tiers: what is in it stays as it is, and a tier whose name is taken
    gets another. The result goes to -o, or with --overwrite into that file itself. What people change in the tiers
    seen and absent comes back by facetrack fix --import.

    \b
    Examples:
      facetrack export out/ --to mot
      facetrack export out/trajectory.csv --to dlc -o clip.csv
      facetrack export out/ --to otb --target face/nose -o -
      facetrack export out/trajectory.csv --to eaf --media clip.mp4
      facetrack export out/ --to elan --into session.eaf --overwrite

    \b
    Exit codes: 0 done, 2 usage or output, 3 input.
    """
    from facetrack_cli.core.files import StreamSink, check_new, write_new
    from facetrack_cli.runs.export import content, encoded
    from facetrack_cli.trajectory.header import clip_of

    to = ALIASES.get(to, to)
    if into is not None and to != "eaf":
        raise UsageError(f"--into adds the tiers of eaf to a file of ELAN; {to} has none")
    if media is not None and to not in OF_MEDIA:
        raise UsageError(f"--media is for {', '.join(OF_MEDIA)}; {to} does not name the clip")
    if box is not None and to not in OF_BOXES:
        raise UsageError(f"--box is for {', '.join(OF_BOXES)}; {to} has no boxes")
    if drop_lost and to == "eaf":
        raise UsageError("--drop-lost is not for eaf, which has a tier for what was lost; leave it out")
    if out == "":
        raise OutputError("--out is empty; name a file, or - for standard output")
    if out == "-" and to == "dlc-h5":
        raise OutputError("dlc-h5 is not text, and does not go to standard output; name a file with -o")
    clips, many = _clips(trajectory, to, target, drop_lost)
    table = clips[0].table
    folder, stem = (trajectory, trajectory.resolve().name) if many else (table.path.parent, table.path.stem)
    path = None if out == "-" else Path(out) if out else into or folder / f"{stem}.{EXPORTS[to].ending}"
    if path is not None:
        check_new(path, overwrite=overwrite, inputs=(table.path, media, clip_of(table)))
    try:
        about: Any = {"media": media, "into": into, "box": box}
        made = content(clips, to, path, many=many, say=say, **about)
    except InputError as e:
        # what is wrong within the table has no file's name yet
        known = str(e).startswith((str(table.path), str(media), str(into)))
        raise e if known else InputError(f"{table.path}: {e}") from None
    if path is None:
        StreamSink(sys.stdout.buffer).finish(lambda _: str(made))
        return
    write_new(path, encoded(made), overwrite=overwrite)
    frames = table.frames
    begins = f"; line 1 is frame {frames[0]}" if to in ("otb", "got10k") and frames[0] else ""
    what = f"{len(frames)} frame{'s' * (len(frames) != 1)} of {', '.join(table.targets) or 'one target'}"
    say(f"{path}: {what if not many else f'{len(clips)} clips'}{begins}")


def _clips(trajectory: Path, to: str, target: str | None, drop_lost: bool) -> tuple[list[Clip], bool]:
    """The trajectory, or those of the many runs in a folder, less what cannot be read; whether there are many."""
    from facetrack_cli.run_folder.manifest import read_run
    from facetrack_cli.trajectory.formats.tables import Clip
    from facetrack_cli.trajectory.header import clip_of
    from facetrack_cli.trajectory.select import blank_lost, choose

    paths = [] if any(trajectory.glob("trajectory.*")) else trajectory.glob("*/trajectory.*")
    folders = sorted({path.parent for path in paths})
    if (many := bool(folders)) and "clips" not in EXPORTS[to].takes.split():
        raise UsageError(f"{trajectory}: is a folder of runs, and {to} takes one; name that of one run")
    found = []
    for path in folders or [trajectory]:
        try:
            table = choose(read_run(path), target)
        except (InputError, UsageError) as e:
            if not many:
                raise
            say(f"facetrack: warning: {e}; it is left out")
            continue
        clip = clip_of(table)
        found.append(Clip(clip.name if clip else table.path.parent.name, blank_lost(table) if drop_lost else table))
    if not found:
        raise InputError(f"{trajectory}: none of its runs can be read; look at facetrack status")
    return found, many


_NAMES = {form: ", ".join([form, *(alias for alias, of in ALIASES.items() if of == form)]) for form in EXPORTS}
_LIST = "\n  ".join(f"{_NAMES[form]:<9} {export.about}" for form, export in EXPORTS.items())
command.help = inspect.cleandoc(str(command.help)).replace("FORMATS", _LIST)
