"""facetrack export: a trajectory as other tools read it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.core.errors import InputError, OutputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from facetrack_cli.trajectory.select import Around
    from facetrack_cli.trajectory.trajectory import Trajectory

ENDINGS = {
    "mot": ".mot.txt",
    "otb": ".otb.txt",
    "got10k": ".got10k.txt",
    "vot": ".vot.txt",
    "coco": ".coco.json",
    "dlc": ".dlc.csv",
    "eaf": ".eaf",
}
ONE_TARGET = ("otb", "got10k", "vot")
OF_BOXES = ("mot", *ONE_TARGET, "coco")
OF_MEDIA = ("coco", "eaf")


@click.command()
@click.argument("trajectory", metavar="TRAJECTORY", type=click.Path(path_type=Path))
@click.option("--to", "form", required=True, type=click.Choice(list(ENDINGS)), help="Format, as below.")
@click.option("-o", "--out", metavar="FILE", help="File to write [default: beside TRAJECTORY]; - standard output.")
@click.option("--target", "select", metavar="NAME[/PART]", help="One target, or one part of it, alone.")
@click.option("--media", metavar="FILE", type=click.Path(path_type=Path), help="Clip it was tracked in (coco, eaf).")
@click.option(
    "--box",
    "around",
    type=click.Choice(["windows", "points"]),
    help="A box around points encloses their windows [default], or their centres alone.",
)
@click.option("--drop-lost", is_flag=True, help="Write lost rows as not known, not with the estimate.")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there already.")
def command(
    trajectory: Path,
    form: str,
    out: str | None,
    select: str | None,
    media: Path | None,
    around: Around | None,
    drop_lost: bool,
    overwrite: bool,
) -> None:
    """Write a trajectory as other tools read it.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run. The file goes beside it, with the ending of
    its format, unless -o says otherwise.

    \b
    Formats:
      mot     MOTChallenge results: frame, id, box, confidence; all from 1
      otb     OTB boxes, one a line, pixels from 1; one target
      got10k  GOT-10k boxes, one a line, pixels from 1; one target
      vot     VOT result, one region a line, pixels from 0; one target
      coco    COCO keypoints JSON: boxes and points of every frame
      dlc     DeepLabCut CSV: x, y, likelihood of every point
      eaf     ELAN annotations: what was lost, how the head moved

    In mot, otb, got10k, vot and coco, a target of several points has the box around the windows that the tracker
    compares; with --box points, around the points alone.

    Lost rows hold the tracker's estimate. mot, coco and dlc give its confidence, coco also the visibility 1 (2 is
    tracked). With --drop-lost they are as if nothing was found: no row in mot, no keypoint in coco, an empty cell in
    dlc, nan in otb and got10k, a failure in vot.

    eaf has tiers for lost parts, motion to the left, right, up and down, tilt, size, nods and shakes: as seen in the
    picture plane. It needs the video, coco the picture's size: both stand in a trajectory.json, else give --media.

    \b
    Examples:
      facetrack export out/ --to mot
      facetrack export out/trajectory.csv --to dlc -o clip.csv
      facetrack export out/ --to otb --target face/nose -o -
      facetrack export out/trajectory.csv --to eaf --media clip.mp4

    \b
    Exit codes: 0 done, 2 usage or output, 3 input.
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.trajectory.header import clip_of
    from facetrack_cli.trajectory.reader import read_trajectory
    from facetrack_cli.trajectory.select import blank_lost, choose

    if media is not None and form not in OF_MEDIA:
        raise UsageError(f"--media is for {' and '.join(OF_MEDIA)}; {form} does not name the clip")
    if around is not None and form not in OF_BOXES:
        raise UsageError(f"--box is for {', '.join(OF_BOXES)}; {form} has no boxes")
    if drop_lost and form == "eaf":
        raise UsageError("--drop-lost is not for eaf, which has a tier for what was lost; leave it out")
    if out == "":
        raise OutputError("--out is empty; name a file, or - for standard output")
    table = choose(read_trajectory(trajectory), select)
    path = None if out == "-" else Path(out) if out else table.path.with_name(table.path.stem + ENDINGS[form])
    if path is not None:
        check_new(path, overwrite=overwrite, inputs=(table.path, media, clip_of(table)))
    try:
        text = _text(blank_lost(table) if drop_lost else table, form, path, media, around or "windows")
    except InputError as e:
        # what is wrong within the table has no file's name yet
        raise e if str(e).startswith((str(table.path), str(media))) else InputError(f"{table.path}: {e}") from None
    _write(text, path, overwrite)
    if path is not None:
        _tell(f"{path}: {_summary(table, form)}")


def _text(table: Trajectory, form: str, path: Path | None, media: Path | None, around: Around) -> str:
    from datetime import datetime

    import numpy as np

    from facetrack_cli.trajectory.formats import boxes, eaf, keypoints
    from facetrack_cli.trajectory.header import said
    from facetrack_cli.trajectory.select import enclose

    if not np.isfinite(table.x).any():
        raise InputError("no row has a place, x and y; there is nothing to export")
    if form == "dlc":
        recipe = said(table, "recipe", "name")
        return keypoints.write_dlc(table, f"facetrack-{recipe}" if recipe else "facetrack")
    if form == "eaf":
        clip = _clip(table, media)
        return eaf.write_eaf(table, clip, path.parent if path else Path.cwd(), written=datetime.now())
    if form == "coco":
        size, file_name = _pictures(table, media)
        return keypoints.write_coco(table, size, file_name, around=around)
    if form in ONE_TARGET and len(table.targets) > 1:
        raise UsageError(f"{form} holds one target; choose with --target among {', '.join(table.targets)}")
    chosen = [enclose(table.of_target(target), around) for target in table.targets]
    if form == "mot":
        return boxes.write_mot(chosen)
    return {"otb": boxes.write_otb, "got10k": boxes.write_got10k, "vot": boxes.write_vot}[form](chosen[0])


def _clip(table: Trajectory, media: Path | None) -> Path:
    """The video that an .eaf links to. It need not be there: ELAN asks for a file that it does not find."""
    from facetrack_cli.trajectory.header import clip_of, is_there

    clip = media or clip_of(table)
    if clip is None:
        raise InputError("does not name its video, only a trajectory.json does; give it with --media")
    if is_there(clip) and clip.is_dir():
        raise InputError(f"{clip} is a folder of images, which ELAN cannot play; name a video of it with --media")
    if not is_there(clip):
        if media is not None:
            raise InputError(f"{clip}: no such file; correct --media")
        _tell(f"facetrack: warning: {clip} is not there; ELAN will ask for it, or give it with --media")
    return clip


def _pictures(table: Trajectory, media: Path | None) -> tuple[tuple[int, int], Callable[[int], str]]:
    """The size of the frames, and the names of their images."""
    from facetrack_cli.trajectory.header import clip_of, is_there, picture_of
    from facetrack_cli.video import images
    from facetrack_cli.video.source import open_source

    clip = media or clip_of(table)
    size = picture_of(table)
    if media is not None:
        with open_source(media) as opened:
            found = opened.size
        if size and size != found:
            raise InputError(
                f"{media}: is {found[0]}x{found[1]}, but the track is of a clip of {size[0]}x{size[1]}; correct --media"
            )
        size = found
    if not size or clip is None:
        raise InputError("does not say how large its pictures are, only a trajectory.json does; name the clip: --media")
    files = images.listing(clip) if is_there(clip) else None
    last = int(table.frames[-1])
    if files is not None and last >= len(files):
        raise InputError(f"{clip}: has {len(files)} images, and the track a frame {last}; name its folder with --media")
    names = [file.name for file in files] if files is not None else None
    return size, lambda frame: names[frame] if names is not None else f"{clip.stem}/{frame:06d}.png"


def _write(text: str, path: Path | None, overwrite: bool) -> None:
    from facetrack_cli.core.files import StreamSink, write_new

    if path is None:
        StreamSink(sys.stdout.buffer).finish(lambda _: text)
    else:
        write_new(path, text.encode(errors="backslashreplace"), overwrite=overwrite)


def _tell(message: str) -> None:
    """A line on standard error, also where a name holds line breaks."""
    click.echo(" ".join(message.splitlines()), err=True)


def _summary(table: Trajectory, form: str) -> str:
    frames = table.frames
    begins = f"; line 1 is frame {frames[0]}" if form in ("otb", "got10k") and frames[0] else ""
    return f"{len(frames)} frames of {', '.join(table.targets) or 'one target'}{begins}"
