"""The annotated video painted anew from the rows; the particles are not in them, and are not drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import corners
from facetrack_cli.core.types import Frame, PartResult, Result, Status, TargetResult, Told
from facetrack_cli.editor.files.rows import Rows
from facetrack_cli.editor.files.run_folder import Run
from facetrack_cli.editor.retrack import Report, StoppedError
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter


def repaint(
    run: Run,
    rows: Rows,
    *,
    report: Report = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[str, ...]:
    """Write the video of a run `beside` the one that it has, and say what could not be kept of it, a line each.

    Raises StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
    """
    index, total = rows.index, len(rows.index)
    done = 0
    with open_source(run.clip, fps=run.fps, start=index.first, stop=index.last + 1) as source:
        overlay = Overlay(source.size, fps=float(source.fps), title=run.recipe.name)
        sound = source.path if source.is_video else None
        assert run.video is not None
        video = VideoWriter(run.video, source.size, source.fps, audio_from=sound, replace=False)
        try:
            for frame in source:
                if stop():
                    raise StoppedError
                video.write(overlay.draw(result_of(rows, frame)), frame.time_s)
                done += 1
                report(done, total)
            if done < total:
                missing = index.first + done
                raise InputError(f"{run.clip}: has no frame {missing}, which the run has; name its clip with --clip")
        except BaseException:
            video.discard()
            raise
        video.close()
        return tuple(video.warnings)


def result_of(rows: Rows, frame: Frame) -> Result:
    """The rows of a frame as the tracker's result; without particles."""
    return Result(frame, tuple(_target(one) for one in rows.targets(frame.index)))


def _target(found: Mapping[str, Any]) -> TargetResult:
    parts = tuple(_part(one, found.get("affine")) for one in found["parts"])
    told = None
    if "scale" in found or "posterior" in found:
        told = Told(scale=found.get("scale"), noise=found.get("noise"), posterior=found.get("posterior"))
    return TargetResult(
        found["target"],
        parts,
        found.get("particles"),
        np.empty((0, len(parts), 2)),
        found.get("identity"),
        found.get("identity_prob"),
        told=told,
    )


def _part(found: Mapping[str, Any], affine: list[float] | None) -> PartResult:
    x, y, w, h = (float(found.get(key, math.nan)) for key in "xywh")
    std = found.get("std_x"), found.get("std_y")
    part = PartResult(
        found["part"],
        x,
        y,
        w,
        h,
        cast(Status, found["status"]),
        found.get("confidence"),
        None if std[0] is None or std[1] is None else (std[0] ** 2, 0.0, std[1] ** 2),  # the rows have no covariance
        found.get("ess"),
        found.get("angle"),
    )
    return part if affine is None else replace(part, corners=corners(np.array(affine), part))


def cells(found: Mapping[str, Any]) -> list[list[Any]]:
    """The parts of a target's object as the page has them: x, y, w, h, angle, confidence, status, by hand, corners."""
    affine = found.get("affine")
    told = []
    for one in found["parts"]:
        outline = None
        if affine is not None and "x" in one:
            outline = _part(one, affine).corners
        told.append(
            [
                *(one.get(key) for key in ("x", "y", "w", "h", "angle", "confidence", "status")),
                bool(one.get("by_hand", False)),
                None if outline is None else np.round(outline, 2).tolist(),
            ]
        )
    return told
