"""A run at a glance: where its parts are least certain, and which frames are worth looking at."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Correction, Mask, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

MOST_DOUBTFUL: Final = 100
DOUBT: Final = 0.5  # a confidence below this is worth a look


def overview(rows: Trajectory, bins: int, corrections: tuple[Correction, ...] = ()) -> dict[str, Any]:
    """Ready for JSON: of each part and each of `bins` equal stretches the least confidence, None if unknown, and the
    shares of frames in which it is lost and absent; the doubtful stretches, worst first; the corrections.
    """
    first, last = int(rows.frame[0]), int(rows.frame[-1])
    count = last - first + 1
    bins = max(1, min(bins, count))
    edges = np.arange(bins) * count // bins
    sizes = np.diff([*edges.tolist(), count])
    parts = []
    for one in rows.parts:
        least = np.fmin.reduceat(one.confidence, edges)
        parts.append(
            {
                "target": one.target,
                "part": one.part,
                "least": [None if sure != sure else sure for sure in least.tolist()],
                "lost": _shares(one.status == "lost", edges, sizes),
                "absent": _shares(one.status == "absent", edges, sizes),
            }
        )
    return {
        "first": first,
        "last": last,
        "bins": bins,
        "parts": parts,
        "doubtful": doubtful(rows),
        "corrections": [
            {
                "frame": one.frame,
                "target": one.target,
                "parts": ["box"] if one.given.box is not None else list(one.given.points),
                "absent": True if one.absent is True else list(one.absent),
            }
            for one in corrections
            if one.frame <= last
        ],
    }


def doubtful(rows: Trajectory, level: float = DOUBT) -> list[dict[str, Any]]:
    """The worst frame of each stretch in which a part is lost or its confidence below `level`, worst first."""
    found = []
    for column, one in enumerate(rows.parts):
        sure = one.confidence
        doubt = np.isfinite(sure) & (one.status != "absent") & ((one.status == "lost") | (sure < level))
        worst = [begin + int(np.argmin(sure[begin:end])) for begin, end in spans(doubt)]
        found += sorted((float(sure[at]), at, column) for at in worst)[:MOST_DOUBTFUL]
    first = int(rows.frame[0])
    return [
        {
            "frame": at + first,
            "target": rows.parts[column].target,
            "part": rows.parts[column].part,
            "confidence": sure,
            "status": str(rows.parts[column].status[at]),
        }
        for sure, at, column in sorted(found)[:MOST_DOUBTFUL]
    ]


def _shares(those: Mask, edges: Whole, sizes: Whole) -> list[float]:
    return [round(share, 4) for share in (np.add.reduceat(those.astype(np.int64), edges) / sizes).tolist()]
