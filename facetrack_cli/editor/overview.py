"""A run at a glance: where its parts are least certain, and which frames are worth looking at."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.spans import spans
from facetrack_cli.core.types import Correction
from facetrack_cli.editor.files.rows import Rows
from facetrack_cli.editor.files.run_index import STATUS, UNKNOWN

MOST_DOUBTFUL: Final = 100
DOUBT: Final = 0.5  # of a confidence that is below this, somebody should look
_STEPS: Final = 10_000
_LOST, _ABSENT = STATUS.index("lost"), STATUS.index("absent")


def overview(rows: Rows, bins: int, corrections: tuple[Correction, ...] = ()) -> dict[str, Any]:
    """Ready for JSON: of each part and of each of `bins` equal stretches the least confidence, None if unknown, and the
    shares of frames in which it is lost and absent; the doubtful stretches, worst first; the corrections.
    """
    index = rows.index
    bins = max(1, min(bins, len(index)))
    edges = np.arange(bins) * len(index) // bins
    sizes = np.diff([*edges.tolist(), len(index)])
    parts = []
    for column, (target, part) in enumerate(_parts(rows)):
        status, sure = rows.status[:, column], rows.confidence[:, column]
        least = np.minimum.reduceat(sure, edges)
        parts.append(
            {
                "target": target,
                "part": part,
                "least": [None if one == UNKNOWN else one / _STEPS for one in least.tolist()],
                "lost": _shares(status == _LOST, edges, sizes),
                "absent": _shares(status == _ABSENT, edges, sizes),
            }
        )
    return {
        "first": index.first,
        "last": index.last,
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
            if one.frame <= index.last
        ],
    }


def doubtful(rows: Rows, level: float = DOUBT) -> list[dict[str, Any]]:
    """The worst frame of each stretch in which a part is lost or its confidence below `level`, worst first."""
    found: list[tuple[int, int, int]] = []  # confidence, frame, column
    for column in range(rows.status.shape[1]):
        status, sure = rows.status[:, column], rows.confidence[:, column]
        told = sure != UNKNOWN
        doubt = told & (status != _ABSENT) & ((status == _LOST) | (sure < level * _STEPS))
        doubts = spans(doubt)
        if not doubts:
            continue
        begins, ends = np.array(doubts).T
        # the least of each stretch, and of what lies between two of them, which is passed over
        pairs = np.stack([begins, ends], axis=1).ravel()
        worst = np.minimum.reduceat(np.append(sure, np.uint16(UNKNOWN)), pairs)[::2]
        few = np.argsort(worst, kind="stable")[:MOST_DOUBTFUL]
        for stretch in few.tolist():
            begin, end = int(begins[stretch]), int(ends[stretch])
            at = begin + int(np.argmin(sure[begin:end]))
            found.append((int(sure[at]), at, column))
    names = _parts(rows)
    return [
        {
            "frame": at + rows.index.first,
            "target": names[column][0],
            "part": names[column][1],
            "confidence": sure / _STEPS,
            "status": STATUS[int(rows.status[at, column])],
        }
        for sure, at, column in sorted(found)[:MOST_DOUBTFUL]
    ]


def _parts(rows: Rows) -> list[tuple[str, str]]:
    return [(target, part) for target, parts in rows.index.parts.items() for part in parts]


def _shares(those: NDArray[np.bool_], edges: NDArray[np.int64], sizes: NDArray[np.int64]) -> list[float]:
    return [round(share, 4) for share in (np.add.reduceat(those.astype(np.int64), edges) / sizes).tolist()]
