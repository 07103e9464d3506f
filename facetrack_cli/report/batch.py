"""One HTML file about the runs of a batch: a table of its clips, the worst first, with a still of each."""

from __future__ import annotations

import os
import urllib.parse
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.files import TABLES
from facetrack_cli.report.frames import Image, Report, key_images
from facetrack_cli.report.make import ReportPage, encoded, page_template
from facetrack_cli.run_folder.manifest import REPORT, VIDEO, read_run, trajectory_of
from facetrack_cli.run_folder.status import ClipStatus, badness, name_of, survey
from facetrack_cli.trajectory.header import read_header

PAGE = "batch.html"
MAX_NOTES = 5  # lines on clips without a picture
_WIDE = 320  # pixels of a still


class Row(NamedTuple):
    """A clip of the table: its picture, if there is one, and links to its files, relative to the page."""

    clip: ClipStatus
    name: str
    still: Image | None
    links: tuple[tuple[str, str], ...]


def make_batch_report(
    batch: Path, to: Path, title: str | None = None, report: Report = lambda done, total: None
) -> ReportPage:
    """The page about the runs in the folder `batch`, to be written to the file `to`.

    Raises InputError for a folder without runs, UsageError without Jinja2.
    """
    template, found = page_template("batch.html.j2"), survey(batch)
    notes: list[str] = []
    rows = []
    for n, clip in enumerate(sorted(found.clips, key=badness)):
        report(n, len(found.clips))
        folder, still = batch / clip.folder, None
        if clip.state == "done":
            try:
                still = _still(folder, clip)
            except FacetrackError as e:
                notes.append(str(e))
        there = [(name, folder / name) for name in (REPORT, VIDEO, *TABLES) if (folder / name).is_file()]
        links = [(name, urllib.parse.quote(os.path.relpath(file, to.parent))) for name, file in there]
        rows.append(Row(clip, name_of(clip), still, tuple(links)))
    if not rows:
        raise InputError(f"{batch}: has no runs yet; wait for the first, or look at facetrack status {batch}")
    title = f"{batch.resolve().name}, {len(rows)} clips" if title is None else title
    if len(notes) > MAX_NOTES:
        notes[MAX_NOTES:] = [f"and {len(notes) - MAX_NOTES} more clips without a picture"]
    return ReportPage(encoded(template.render(title=title, rows=rows, counts=found.counts)), tuple(notes))


def _still(folder: Path, clip: ClipStatus) -> Image | None:
    """The frame to look at first, or else the middle one, reduced."""
    table = read_run(trajectory_of(folder))
    frames = table.frames
    at = int(frames[len(frames) // 2]) if clip.still is None else clip.still
    video = folder / VIDEO
    made = key_images(
        table, read_header(table), [at], None, video if video.is_file() else None, lambda done, total: None
    )
    if at not in made.found:
        return None
    image = cv2.imdecode(np.frombuffer(made.found[at].data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    size = (_WIDE, max(round(_WIDE * image.shape[0] / image.shape[1]), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return Image(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes(), size)
