"""Stages side by side give what one thread gives, end when one of them fails, and stop between two frames."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from facetrack_cli.core.types import Frame
from facetrack_cli.runs import pipeline
from facetrack_cli.trajectory.trajectory import FrameResult

both = pytest.mark.parametrize("threaded", [False, True], ids=["one-thread", "threads"])


class BoomError(Exception):
    pass


def frames(n: int, fail_at: int | None = None, made: list[int] | None = None) -> Iterator[Frame]:
    for i in range(n):
        if i == fail_at:
            raise BoomError(f"frame {i}")
        if made is not None:
            made.append(i)
        yield Frame(i, i / 25, np.zeros((2, 2, 3), np.uint8))


def track(given: Iterator[Frame]) -> Iterator[FrameResult]:
    for frame in given:
        yield FrameResult(frame, ())


def run(
    given: Iterator[Frame],
    track: Callable[[Iterator[Frame]], Iterator[FrameResult]],
    record: Callable[[FrameResult], None],
    paint: Callable[[FrameResult], None],
    *,
    threaded: bool = True,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """The stages as a run puts them together."""
    painter = pipeline.Painter(paint, threaded=threaded)
    try:
        with pipeline.decoded_ahead(given, threaded=threaded, stopped=stopped) as decoded:
            for result in track(decoded):
                record(result)
                painter.put(result)
    finally:
        painter.end()


class Seen(list[int]):
    def __call__(self, result: FrameResult) -> None:
        self.append(result.frame.index)


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = threading.active_count()
    yield
    deadline = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() <= before  # a thread of an earlier test may end meanwhile


@both
@pytest.mark.parametrize("n", [0, 100])
def test_every_frame_passes_in_order(threaded: bool, n: int) -> None:
    recorded, painted = Seen(), Seen()
    run(frames(n), track, recorded, painted, threaded=threaded)
    assert recorded == painted == list(range(n))


@both
def test_a_decoder_that_fails_keeps_what_came_before(threaded: bool) -> None:
    recorded, painted = Seen(), Seen()
    with pytest.raises(BoomError, match="frame 20"):
        run(frames(50, fail_at=20), track, recorded, painted, threaded=threaded)
    assert recorded == painted == list(range(20))


@both
def test_a_tracker_that_fails_keeps_what_came_before(threaded: bool) -> None:
    def failing(given: Iterator[Frame]) -> Iterator[FrameResult]:
        for result in track(given):
            if result.frame.index == 20:
                raise BoomError("track")
            yield result

    recorded, painted = Seen(), Seen()
    with pytest.raises(BoomError, match="track"):
        run(frames(10_000), failing, recorded, painted, threaded=threaded)
    assert recorded == painted == list(range(20))


@both
@pytest.mark.parametrize("at", [0, 20])
def test_a_painter_that_fails_ends_the_run_soon(threaded: bool, at: int) -> None:
    def paint(result: FrameResult) -> None:
        if result.frame.index == at:
            raise BoomError("paint")

    recorded = Seen()
    with pytest.raises(BoomError, match="paint"):
        run(frames(10_000), track, recorded, paint, threaded=threaded)
    assert at < len(recorded) < 10_000


def test_a_painter_that_fails_on_the_last_frames_is_raised() -> None:
    def paint(result: FrameResult) -> None:
        time.sleep(0.05)
        if result.frame.index == 3:
            raise BoomError("late")

    with pytest.raises(BoomError, match="late"):
        run(frames(4), track, Seen(), paint)


@both
def test_a_wish_to_stop_ends_after_the_frame_at_hand(threaded: bool) -> None:
    recorded, painted = Seen(), Seen()
    run(frames(10_000), track, recorded, painted, threaded=threaded, stopped=lambda: len(recorded) >= 7)
    assert recorded == painted == list(range(7))


def test_a_stop_is_granted_while_the_decoder_hangs() -> None:
    release = threading.Event()

    def hanging() -> Iterator[Frame]:
        yield from frames(3)
        release.wait(20)

    recorded, painted = Seen(), Seen()
    began = time.monotonic()
    threading.Timer(0.3, release.set).start()
    run(hanging(), track, recorded, painted, stopped=lambda: len(recorded) == 3 and time.monotonic() - began > 0.1)
    assert recorded == painted == [0, 1, 2]
    release.set()


def test_queues_are_short() -> None:
    """What has been decoded is never far ahead of what has been painted."""
    made: list[int] = []
    ahead: list[int] = []

    def paint(result: FrameResult) -> None:
        time.sleep(0.002)
        ahead.append(len(made) - result.frame.index)

    run(frames(100, made=made), track, lambda result: None, paint)
    assert max(ahead) <= 2 * pipeline.MAX_QUEUE + 4


def test_large_frames_wait_in_shorter_queues(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "MAX_QUEUE_BYTES", 25)  # of frames of 12 bytes two fit
    made: list[int] = []
    ahead: list[int] = []

    def paint(result: FrameResult) -> None:
        time.sleep(0.005)
        ahead.append(len(made) - result.frame.index)

    run(frames(60, made=made), track, lambda result: None, paint)
    assert max(ahead) <= 2 * 2 + 4
    monkeypatch.setattr(pipeline, "MAX_QUEUE_BYTES", 1)  # one is let in however large it is
    recorded = Seen()
    run(frames(20), track, recorded, Seen())
    assert recorded == list(range(20))


def test_stages_overlap() -> None:
    """Three stages of 5 ms each take a good deal less than 15 ms a frame."""

    def slow(given: Iterator[Frame]) -> Iterator[Frame]:
        for frame in given:
            time.sleep(0.005)
            yield frame

    def doze(result: FrameResult) -> None:
        time.sleep(0.005)

    began = time.perf_counter()
    run(slow(frames(60)), lambda given: track(slow(given)), lambda result: None, doze)
    assert time.perf_counter() - began < 60 * 0.015 * 0.75
