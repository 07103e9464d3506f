"""Stages side by side give what one thread gives, end when one of them fails, and stop between two frames."""

import threading
import time

import numpy as np
import pytest

from facetrack_cli.core.types import Frame
from facetrack_cli.runs import workers
from facetrack_cli.trajectory.trajectory import FrameResult

both = pytest.mark.parametrize("threaded", [False, True], ids=["one-thread", "threads"])


class BoomError(Exception):
    pass


def failing(stage, at):
    """A stage that fails at a frame."""

    def fail(result):
        if result.frame.index == at:
            raise BoomError("boom")
        stage(result)

    return fail


def frames(n, fail_at=None, made=None):
    for i in range(n):
        if i == fail_at:
            raise BoomError("boom")
        if made is not None:
            made.append(i)
        yield Frame(i, i / 25, np.zeros((2, 2, 3), np.uint8))


class Seen(list):
    def __call__(self, result):
        self.append(result.frame.index)


def run(given, record, paint, *, track=lambda frame: None, threaded=True, stopped=lambda: False):
    """The stages as a run puts them together."""
    painter = workers.Painter(paint, threaded=threaded)
    try:
        with workers.decoded_ahead(given, threaded=threaded, stopped=stopped) as decoded:
            for frame in decoded:
                track(result := FrameResult(frame, ()))
                record(result)
                painter.put(result)
    finally:
        painter.end()


@pytest.fixture(autouse=True)
def no_thread_is_left():
    before = threading.active_count()
    yield
    deadline = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() <= before  # a thread of an earlier test may end meanwhile


@both
@pytest.mark.parametrize(("n", "fails"), [(0, ""), (100, ""), (100, "decode"), (10_000, "track")])
def test_every_frame_passes_in_order_and_an_error_keeps_what_came_before(threaded, n, fails):
    recorded, painted = Seen(), Seen()
    more = {"track": failing(lambda result: None, 20)} if fails == "track" else {}
    try:
        run(frames(n, 20 if fails == "decode" else None), recorded, painted, threaded=threaded, **more)
    except BoomError:
        assert fails
    assert recorded == painted == list(range(20 if fails else n))


@both
@pytest.mark.parametrize(("at", "n"), [(0, 10_000), (20, 10_000), (3, 4)])
def test_a_painter_that_fails_ends_the_run_soon(threaded, at, n):
    recorded = Seen()
    with pytest.raises(BoomError):
        run(frames(n), recorded, failing(lambda result: None, at), threaded=threaded)
    assert at < len(recorded) < 10_000


@both
def test_a_wish_to_stop_ends_after_the_frame_at_hand(threaded):
    recorded, painted = Seen(), Seen()
    run(frames(10_000), recorded, painted, threaded=threaded, stopped=lambda: len(recorded) >= 7)
    assert recorded == painted == list(range(7))


@pytest.mark.parametrize(("most_bytes", "queue"), [(workers.MAX_QUEUE_BYTES, workers.MAX_QUEUE), (25, 2), (1, 1)])
def test_queues_are_short_and_those_of_large_frames_shorter(monkeypatch, most_bytes, queue):
    """What has been decoded is never far ahead of what has been painted; frames of 12 bytes here."""
    monkeypatch.setattr(workers, "MAX_QUEUE_BYTES", most_bytes)
    made, ahead, threads = [], [], set()

    def paint(result):
        time.sleep(0.003)
        threads.add(threading.current_thread().name)
        ahead.append(len(made) - result.frame.index)

    recorded = Seen()
    run(frames(60, made=made), recorded, paint)
    assert recorded == list(range(60)) and max(ahead) <= 2 * queue + 4 and threads == {"paint_0"}
