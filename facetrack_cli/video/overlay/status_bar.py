"""The status bar: a dark translucent strip with frame, time, status, title and mean confidence, where there is room."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2

from facetrack_cli.core.numbers import clock
from facetrack_cli.core.types import Image, Result, Status, TargetResult
from facetrack_cli.video.overlay.marks import PALETTE, WHITE, Colour, mark
from facetrack_cli.video.overlay.text import Font, stamp

_QUIET: Colour = (190, 190, 190)


_TROUGH: Colour = (130, 130, 130)


LOST_TEXT: Colour = (110, 165, 255)  # vermilion itself is too dark to read on the strip


# what stands in the bar beside the status; the last goes first where it is narrow
_ITEMS = ("frame", "gauge", "clock", "title", "percent", "scale", "particles")


class StatusBar:
    """Writes what a result says as a whole over the top of pictures `width` pixels wide, capitals `cap` pixels high."""

    def __init__(self, width: int, cap: int, line: int, title: str = "") -> None:
        self.height = round(1.9 * cap)
        self._width = width
        self._line = line
        self._title = title
        self._font = Font(cap)

    def draw(self, image: Image, result: Result) -> None:
        """Darken the top `height` rows of `image` (H, W, 3) and write on them, in place."""
        font, cap = self._font, self._font.cap
        strip = image[: self.height]
        cv2.convertScaleAbs(strip, strip, 0.28)
        status, sayings = summary(result.targets)
        sure = [
            p.confidence
            for t in result.targets
            for p in t.parts
            if p.confidence is not None and math.isfinite(p.confidence)
        ]
        mean = min(max(sum(sure) / len(sure), 0.0), 1.0) if sure else 0.0
        texts = {"frame": f"#{result.frame.index}", "clock": clock(result.frame.time_s)}
        gap, gauge, icon = round(0.8 * cap), round(3.5 * cap), round(1.5 * cap)
        room = {
            "frame": font.width(texts["frame"]) + gap,
            "gauge": gauge + gap,
            "clock": font.width(texts["clock"]) + gap,
            "title": font.width(self._title) + gap if self._title else 0,
            "percent": font.width("100%") + gap,
        }
        adapted = adaptation(result.targets)
        room |= {item: font.width(text) + gap for item, text in adapted.items()}
        shown, saying, spare = self._fit(sayings, room, self._width - 2 * gap - icon)
        if not sure:  # 0 % would be a lie of a tracker that does not say
            shown = tuple(item for item in shown if item not in ("gauge", "percent"))
        title = self._title if "title" in shown else self._cut_title(spare - gap)
        row, middle = (self.height - cap) // 2 - font.top, (self.height - cap) // 2 + (cap - 1) / 2
        left, right = gap, self._width - gap
        for item in ("frame", "clock"):
            if item in shown:
                stamp(strip, font.passing(texts[item]), left, row)
                left += room[item]
        sign = LOST_TEXT if status == "lost" else _QUIET if status == "absent" else PALETTE[0]
        by_hand = any(part.by_hand for target in result.targets for part in target.parts)
        mark(strip, left + 0.4 * cap, middle, status, sign, 0.37 * cap, self._line, by_hand=by_hand)
        stamp(strip, font.sprite(saying, LOST_TEXT if status == "lost" else WHITE), left + icon, row)
        if "gauge" in shown:
            top, bottom = (self.height - cap) // 2, (self.height - cap) // 2 + cap - 1
            full, end = right - gauge, right - gauge + round(mean * gauge)
            cv2.rectangle(strip, (full, top), (right - 1, bottom), _TROUGH, -1)
            if end > full:
                cv2.rectangle(strip, (full, top), (end - 1, bottom), PALETTE[0], -1)
            right = full - gap
        if "percent" in shown:
            percent = f"{mean:.0%}"
            stamp(strip, font.sprite(percent, WHITE), right - font.width(percent), row)
            right -= room["percent"]
        if title:
            stamp(strip, font.sprite(title, _QUIET), right - font.width(title), row)
            right -= font.width(title) + gap
        for item, text in adapted.items():
            if item in shown:
                stamp(strip, font.sprite(text, _QUIET), right - font.width(text), row)
                right -= room[item]

    def _fit(self, sayings: Sequence[str], room: dict[str, int], width: int) -> tuple[tuple[str, ...], str, int]:
        """The items and the wording of the status that fit, and the room left: rather fewer items than fewer words."""
        items = tuple(item for item in _ITEMS if item in room)
        for counts in ((7, 6, 5, 4, 3), (2, 1, 0)):
            for saying in sayings:
                for n in counts:
                    left = width - self._font.width(saying) - sum(room[k] for k in items[:n])
                    if left >= 0:
                        return items[:n], saying, left
        return (), "", 0

    def _cut_title(self, room: int) -> str:
        """The title's beginning, as far as it says something in `room` pixels."""
        length = len(self._title)
        while length > 7 and self._font.width(self._title[:length] + "..") > room:
            length -= 1
        return self._title[:length] + ".." if length > 7 else ""


def adaptation(targets: Sequence[TargetResult]) -> dict[str, str]:
    """`scale`, and `particles` where their number follows the noise, of a single target that adapts; else nothing.

    Each is about as wide in every frame.
    """
    told = targets[0].told if len(targets) == 1 else None
    if told is None or told.scale is None or not math.isfinite(told.scale):
        return {}
    scale, count = f"scale {min(told.scale, 99.0):.2f}", targets[0].particles
    return (
        {"scale": scale} if count is None or told.noise is None else {"scale": scale, "particles": f"{count} particles"}
    )


def summary(targets: Sequence[TargetResult]) -> tuple[Status, list[str]]:
    """The status of all together, and ways to say it, from the longest to the shortest.

    What is absent is said beside it, and has no say in it unless all is.
    """
    parts = [(t, p) for t in targets for p in t.parts]
    if not parts:
        return "lost", ["no target", "none"]
    absent, lost = (sum(p.status == status for _, p in parts) for status in ("absent", "lost"))
    if absent == len(parts):
        return "absent", ["absent"]
    missing = f"{', '.join(_named(targets, 'absent'))} absent" if absent else ""
    if lost:
        names = _named(targets, "lost")
        whole = "lost: " + ", ".join(names)
        several = [f"lost: {names[0]} +{len(names) - 1}"] if len(names) > 1 else []
        both = [f"{whole}; {missing}"] if missing else []
        return "lost", [*both, whole, *several, f"lost {lost}/{len(parts)}", "lost"]
    status: Status = "init" if all(p.status in ("init", "absent") for _, p in parts) else "tracked"
    given = [p for _, p in parts if p.by_hand and p.status == "init"]
    sayings: list[str] = [status]
    if given:
        status, sayings = "init", [f"{', '.join(_named(targets, 'init', by_hand=True))} by hand", "by hand"]
    both = [f"{sayings[0]}; {missing}", missing, f"absent {absent}/{len(parts)}"] if missing else []
    return status, [*both, *sayings]


def _named(targets: Sequence[TargetResult], status: Status, *, by_hand: bool = False) -> list[str]:
    """The parts of that status; a target where it is all of its parts."""
    names = []
    for target in targets:
        those = [p.name for p in target.parts if p.status == status and (p.by_hand or not by_hand)]
        if those and len(those) == len(target.parts):
            names.append(target.name)
        else:
            names += [f"{target.name}/{name}" if len(targets) > 1 else name for name in those]
    return names
