"""The status bar: a dark translucent strip with frame, time, status, title and mean confidence, where there is room."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from facetrack_cli.core.numbers import clock
from facetrack_cli.core.types import Image, Mask
from facetrack_cli.trajectory.trajectory import FrameResult, Status, Trajectory
from facetrack_cli.video.overlay.marks import PALETTE, WHITE, Colour, Font, mark, readable, stamp

_QUIET: Colour = (190, 190, 190)
_TROUGH: Colour = (130, 130, 130)
LOST_TEXT: Colour = (110, 165, 255)  # vermilion itself is too dark to read on the strip
_WORDY = 28  # heights of capitals: where a bar is as wide, the number of the frame is said to be one
# items in the bar beside the status; in a narrow bar the last items are left out first
_ITEMS = ("frame", "gauge", "clock", "title", "percent", "scale")


class StatusBar:
    """Writes a summary of each result over the top of images `width` pixels wide, in capitals `cap` pixels high."""

    def __init__(self, width: int, cap: int, line: int, title: str = "") -> None:
        self.height = round(1.9 * cap)
        self._width, self._line, self._title, self._font = width, line, title, Font(cap)

    def draw(self, image: Image, result: FrameResult) -> None:
        """Darken the top `height` rows of `image` (H, W, 3) and write on them, in place."""
        font, cap = self._font, self._font.cap
        strip = image[: self.height]
        cv2.convertScaleAbs(strip, strip, 0.28)
        rows = result.rows
        status, sayings = summary(rows)
        sure = rows.confidence[np.isfinite(rows.confidence)].tolist()
        mean = min(max(sum(sure) / len(sure), 0.0), 1.0) if sure else 0.0
        adapted, title = adaptation(rows), self._title
        word = "frame " if self._width >= _WORDY * cap else ""
        texts = {"frame": f"{word}{result.frame.index}", "clock": clock(result.frame.time_s), "title": title}
        texts |= {"percent": "100%", **adapted}
        gap, gauge, icon = round(0.8 * cap), round(3.5 * cap), round(1.5 * cap)
        room = {item: font.width(text) + gap if text else 0 for item, text in texts.items()} | {"gauge": gauge + gap}
        shown, saying, spare = self._fit(sayings, room, self._width - 2 * gap - icon)
        if not sure:  # 0 % would be a lie of a tracker that does not say
            shown = tuple(item for item in shown if item not in ("gauge", "percent"))
        if "title" not in shown:  # its beginning, as far as it says something
            length = next((n for n in range(len(title), 7, -1) if font.width(title[:n] + "..") <= spare - gap), 0)
            title = title[:length] + ".." if length else ""
        row, middle = (self.height - cap) // 2 - font.top, (self.height - cap) // 2 + (cap - 1) / 2
        left, right = gap, self._width - gap
        for item in ("frame", "clock"):
            if item in shown:
                stamp(strip, font.passing(texts[item]), left, row)
                left += room[item]
        sign = LOST_TEXT if status == "lost" else _QUIET if status == "absent" else PALETTE[0]
        by_hand = bool(rows.by_hand.any())
        mark(strip, (left + 0.4 * cap, middle), status, sign, 0.37 * cap, self._line, by_hand)
        stamp(strip, font.sprite(saying, LOST_TEXT if status == "lost" else WHITE), left + icon, row)
        if "gauge" in shown:
            top, bottom = (self.height - cap) // 2, (self.height - cap) // 2 + cap - 1
            full, end = right - gauge, right - gauge + round(mean * gauge)
            cv2.rectangle(strip, (full, top), (right - 1, bottom), _TROUGH, -1)
            if end > full:
                cv2.rectangle(strip, (full, top), (end - 1, bottom), PALETTE[0], -1)
            right = full - gap
        room["title"] = font.width(title) + gap
        for item, text in {"percent": f"{mean:.0%}", "title": title, **adapted}.items():
            if text and (item in shown or item == "title"):
                colour = WHITE if item == "percent" else _QUIET
                stamp(strip, font.sprite(text, colour), right - font.width(text), row)
                right -= room[item]

    def _fit(self, sayings: Sequence[str], room: dict[str, int], width: int) -> tuple[tuple[str, ...], str, int]:
        """The items and the wording of the status that fit, and the room left: rather fewer items than fewer words."""
        items = tuple(item for item in _ITEMS if item in room)
        for counts in ((6, 5, 4, 3), (2, 1, 0)):
            for saying in sayings:
                for n in counts:
                    left = width - self._font.width(saying) - sum(room[k] for k in items[:n])
                    if left >= 0:
                        return items[:n], saying, left
        return (), "", 0


def adaptation(rows: Trajectory) -> dict[str, str]:
    """The size against that of the start, of a single target that adapts; else nothing."""
    found = rows.diagnostics.get(rows.target) if len(rows.targets) == 1 else None
    scale = math.nan if found is None else float(found.get("scale")[0])
    return {"scale": f"size {min(scale, 99.0):.0%}"} if math.isfinite(scale) else {}


def summary(rows: Trajectory) -> tuple[Status, list[str]]:
    """The status of all that is not absent, and ways to say it, from the longest to the shortest."""
    if not len(rows):
        return "lost", ["no target", "none"]
    absent, lost, hidden = (int(np.sum(rows.status == status)) for status in ("absent", "lost", "hidden"))
    if absent == len(rows):
        return "absent", ["absent"]
    missing = f"{', '.join(_named(rows, rows.status == 'absent'))} absent" if absent else ""
    unseen: Status
    for unseen, count in (("lost", lost), ("hidden", hidden)):
        if count:
            names = _named(rows, rows.status == unseen)
            whole = f"{unseen}: {', '.join(names)}"
            several = [f"{unseen}: {names[0]} +{len(names) - 1}"] if len(names) > 1 else []
            both = [f"{whole}; {missing}"] if missing else []
            return unseen, [*both, whole, *several, f"{unseen} {count}/{len(rows)}", unseen]
    init = rows.status == "init"
    status: Status = "init" if (init | (rows.status == "absent")).all() else "tracked"
    given = rows.by_hand & init
    sayings: list[str] = [status]
    if given.any():
        status, sayings = "init", [f"{', '.join(_named(rows, given))} by hand", "by hand"]
    both = [f"{sayings[0]}; {missing}", missing, f"absent {absent}/{len(rows)}"] if missing else []
    return status, [*both, *sayings]


def _named(rows: Trajectory, those: Mask) -> list[str]:
    """The names of `those` rows (R,): the name of the target alone where all of its parts are among them."""
    pairs = [rows.names[i] for i in rows.which.tolist()]
    chosen = [pair for pair, is_one in zip(pairs, those.tolist(), strict=True) if is_one]
    names = []
    for target in rows.targets:
        parts = [part for name, part in chosen if name == target]
        if parts and len(parts) == sum(name == target for name, _ in pairs):
            names.append(readable(target))
        else:
            names += [readable(f"{target}/{part}" if len(rows.targets) > 1 else part) for part in parts]
    return names
