"""Any frame of a clip: the pixels and the time that reading from the start gives, without decoding all before it."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.video.decode import LostError, _is_hidden, open_container, read_index
from facetrack_cli.video.source import Frames, VideoSource, open_source
from tests.support import media

X264 = ("-preset", "medium", "-threads", "1")
VP8 = ("-deadline", "good", "-cpu-used", "5", "-auto-alt-ref", "1", "-lag-in-frames", "16", "-g", "40", "-b:v", "200k")
GAPS = [0.04] * 15 + [0.12] * 10 + [0.02] * 20 + [0.5] * 4 + [0.033] * 40
TIMES = list(itertools.accumulate(GAPS, initial=0.0))

# by name: the options of the encoder, and what else it is made with
B_FRAMES = (*X264, "-bf", "3")
CLIPS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "b_frames.mp4": ((*B_FRAMES, "-g", "45", "-x264-params", "b-pyramid=normal:scenecut=0"), {}),
    "open_gop.mp4": ((*B_FRAMES, "-g", "24", "-x264-params", "open-gop=1:scenecut=0"), {}),
    "open_gop.ts": ((*B_FRAMES, "-g", "24", "-x264-params", "open-gop=1:scenecut=0"), {}),
    "variable.mkv": ((*X264, "-bf", "2", "-g", "30"), {"frames": 90, "times": TIMES}),
    "sound.ts": ((*X264, "-g", "30"), {"sound": "sin(2000*t)"}),
    "fragments.mp4": ((*X264, "-g", "30", "-movflags", "+frag_keyframe+empty_moov"), {}),
    "plain.avi": (("-g", "12"), {}),
    "no_stamps.avi": (("-bf", "2"), {}),
    "vp8.webm": (VP8, {}),
    "vp9.webm": (("-c:v", "libvpx-vp9", *VP8), {}),
    "no_length.webm": (("-live", "1"), {}),
    "hevc.mp4": (("-c:v", "libx265", "-preset", "fast", "-x265-params", "log-level=none:keyint=30:pools=1"), {}),
    "no_stamps.mpg": (("-c:v", "mpeg2video", "-bf", "2"), {}),
    # these are changed after they were encoded
    "edit_list.mp4": ((*X264, "-g", "40"), {"frames": 150}),
    "rotated.mp4": ((*X264, "-bf", "2", "-g", "30"), {}),
    "truncated.mp4": ((*X264, "-g", "30"), {"frames": 160}),
    "middle.ts": ((*B_FRAMES, "-g", "24", "-x264-params", "open-gop=1:scenecut=0"), {"frames": 150}),
    "damaged.mp4": ((*X264, "-g", "30"), {"frames": 120}),
}
# their packets do not tell which frame is which
IN_ORDER = {"no_stamps.avi", "no_stamps.mpg", "damaged.mp4"}
BY_DAY = [
    "b_frames.mp4", "open_gop.ts", "variable.mkv", "plain.avi", "no_stamps.avi", "vp8.webm", "edit_list.mp4",
    "middle.ts", "truncated.mp4", "damaged.mp4",
]  # fmt: skip
EACH = [*BY_DAY, *(pytest.param(name, marks=pytest.mark.nightly) for name in CLIPS if name not in BY_DAY)]


def make(path: Path) -> None:
    options, more = CLIPS[path.name]
    whole = media.write_video(path.with_suffix(f".whole{path.suffix}"), options=options, **{"frames": 100, **more})
    data = bytearray(whole.read_bytes())
    kind = path.stem
    if kind == "edit_list":
        media.ffmpeg("-ss", "1.1", "-i", whole, "-c", "copy", path)
    elif kind == "rotated":
        media.rotated(whole, path, 90)
    else:
        if kind == "damaged":
            data[len(data) // 2 : len(data) // 2 + len(data) // 8] = bytes(len(data) // 8)
        data = data[: int(len(data) * 0.7)] if kind == "truncated" else data[188 * 150 :] if kind == "middle" else data
        path.write_bytes(data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("clips")


READ: dict[str, list[Frame]] = {}


def made(folder: Path, name: str) -> tuple[Path, list[Frame]]:
    """A clip, and its frames as they are read from the start."""
    path = folder / name
    if name not in READ:
        make(path)
        with open_source(path) as source:
            READ[name] = list(source)
    return path, READ[name]


def check(frame: Frame, expected: Frame) -> None:
    assert frame.index == expected.index
    assert frame.time_s == expected.time_s, frame.index  # to the last bit
    assert np.array_equal(frame.pixels, expected.pixels), frame.index


@pytest.mark.parametrize("name", EACH)
def test_every_frame_in_any_order_is_the_one_of_the_source(folder: Path, name: str) -> None:
    path, expected = made(folder, name)
    assert len(expected) > 40
    with Frames(path) as frames:
        assert frames.size == expected[0].size and not frames.exact
        jumped = False
        for index in np.random.default_rng(0).permutation(len(expected))[:16].tolist():
            frames._recent.clear()  # each by a way of its own
            check(frames.read(index), expected[index])
            jumped = jumped or frames._decoder.index is not None
        assert jumped == (name not in IN_ORDER)
        with pytest.raises(InputError, match=rf"the clip has {len(expected)} frames \(0 to {len(expected) - 1}\);"):
            frames.read(len(expected))
        assert frames.exact and frames.count == len(expected)
        last, frames._most = len(expected) - 1, 7  # a small cache, to step in by and to jump over
        for index in (last, 0, 1, 5, last // 2, *range(last // 2, last // 2 - 12, -1), last - 1, last - 3):
            check(frames.read(index), expected[index])
        with pytest.raises(InputError):
            frames.read(-1)


def test_frames_are_counted_where_a_file_does_not_say_how_long_it_is(folder: Path) -> None:
    path, expected = made(folder, "no_length.webm")
    with Frames(path) as frames:
        assert frames.count == len(expected), "or a page would show the first frame alone"


@pytest.mark.parametrize("name", EACH)
def test_a_source_that_begins_late_gives_what_decoding_in_order_gives(folder: Path, name: str) -> None:
    path, frames = made(folder, name)
    jumped = 0
    for start in sorted({1, 18, 45, 46, len(frames) - 20, len(frames) - 1}):
        with open_source(path, start=start, stop=start + 9) as source:
            for got, expected in zip(source, frames[start : start + 9], strict=True):
                check(got, expected)
            assert isinstance(source, VideoSource)
            jumped += source.decoder.index is not None
    assert bool(jumped) == (name not in {*IN_ORDER, "no_length.webm"}), "which has one keyframe"


def test_frames_of_another_size_are_scaled_to_the_first(folder: Path) -> None:
    parts = []
    for place, size in enumerate(((64, 48), (80, 48))):
        part = media.write_video(folder / f"{place}.ts", frames=50, size=size, options=(*X264, "-g", "10"))
        shifted = folder / f"{place}.shifted.ts"
        media.ffmpeg("-i", part, "-c", "copy", "-output_ts_offset", str(place * 2), shifted)
        parts.append(shifted.read_bytes())
    path = folder / "two_sizes.ts"
    path.write_bytes(b"".join(parts))
    with open_source(path) as source:
        expected = list(source)
        assert len(expected) == 100 and {frame.size for frame in expected} == {(64, 48)}
        assert source.warnings[0].endswith("frame 50 is 80x48, the first is 64x48; all are scaled to the first")
    with Frames(path) as frames:
        check(frames.read(45), expected[45])
        check(frames.read(70), expected[70])


# how much is decoded


@pytest.fixture(scope="module")
def long(folder: Path) -> Path:
    """A clip of 600 frames with keyframes 250 apart."""
    options = ("-preset", "ultrafast", "-threads", "1", "-bf", "3", "-g", "250", "-x264-params", "scenecut=0")
    pictures = [media.numbered(index % 256) for index in range(600)]
    return media.write_video(folder / "long.mp4", frames=pictures, options=options)


class Counted(Frames):
    """Counts the frames that are decoded."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.decoded, self._read = 1, self._decoder.read
        self._decoder.read = self._counted  # type: ignore[method-assign]

    def _counted(self) -> Any:
        self.decoded += 1
        return self._read()


def test_stepping_through_neighbours_does_not_decode_them_again(long: Path) -> None:
    with Counted(long) as frames:
        assert media.number(frames.read(480).bgr) == 480 - 256
        assert frames.decoded <= 1 + 240
        for way in (range(479, 300, -1), range(301, 480), range(479, 300, -7)):
            before = frames.decoded
            for index in way:
                assert media.number(frames.read(index).bgr) == index % 256
            assert frames.decoded - before <= 250
        frames._most = 20  # a small cache
        frames.read(490)
        before = frames.decoded
        for index in range(489, 400, -1):
            assert media.number(frames.read(index).bgr) == index % 256
        assert frames.decoded - before <= (90 / 15 + 2) * 240 and len(frames._recent) <= 250


def test_a_far_frame_is_not_decoded_from_the_start(long: Path) -> None:
    with Counted(long) as frames:
        frames.read(250)  # a keyframe
        assert frames.decoded == 2
        frames.read(530)
        assert frames.decoded < 530 - 500 + 10
        assert frames.count == 600 and not frames.exact
        with pytest.raises(InputError):
            frames.read(10**6)
        assert frames.exact and frames.decoded < 200
    with open_source(long, start=530) as source:
        read, decoded = source.decoder.read, 0  # type: ignore[attr-defined]

        def counted() -> object:
            nonlocal decoded
            decoded += 1
            return read()

        source.decoder.read = counted  # type: ignore[attr-defined]
        assert len(list(source)) == 70 and decoded <= 101 + 1


# doubt


def test_an_index_that_differs_is_not_used(folder: Path) -> None:
    path, expected = made(folder, "b_frames.mp4")
    for first in (0, 60):  # from the start, and from the middle on
        with Frames(path) as frames:
            frames._decoder.packets, frames._decoder.indexed = read_index(path), True
            assert frames._decoder.packets is not None
            frames._decoder.packets.pts[first:] += 1
            for index in (90, 99, 30, 70):
                check(frames.read(index), expected[index])
            assert frames._decoder.packets is None


def test_a_frame_that_is_not_where_its_packet_says(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, frames = made(folder, "b_frames.mp4")
    wrong = read_index(path)
    assert wrong is not None
    wrong.pts[80] += 1
    monkeypatch.setattr("facetrack_cli.video.decode.read_index", lambda *_: wrong)
    with open_source(path, start=75) as source:
        got = iter(source)
        check(next(got), frames[75])
        with pytest.raises(LostError, match="frame 80 is not there at the time that its packet says"):
            list(got)
    with open_source(path, start=85) as source:  # a difference on the way: it is decoded from the start
        check(next(iter(source)), frames[85])


@pytest.mark.parametrize("error", [av.InvalidDataError, av.EOFError])
def test_a_file_that_cannot_be_sought_is_read_from_its_start(
    folder: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    path, frames = made(folder, "b_frames.mp4")
    index = read_index(path)

    class Unseekable:
        def __init__(self, container: Any) -> None:
            self._container = container

        def seek(self, *_: object, **__: object) -> None:
            raise error(1, "damaged")

        def __getattr__(self, name: str) -> Any:
            return getattr(self._container, name)

    monkeypatch.setattr("facetrack_cli.video.decode.open_container", lambda at: Unseekable(open_container(at)))
    monkeypatch.setattr("facetrack_cli.video.decode.read_index", lambda *_: index)
    with open_source(path, start=85) as source:
        check(next(iter(source)), frames[85])
    with Frames(path) as any_frame:
        check(any_frame.read(90), frames[90])


def test_hidden_packets_of_vp8_and_vp9_are_no_frames() -> None:
    vp8 = [_is_hidden("vp8", packet) for packet in (b"\x10rest", b"\x01rest", b"\x11rest")]
    assert vp8 == [False, True, False]
    packets = (b"\x82rest\0", b"\x84rest\0", b"\x86rest\0", b"\x84rest\xc9", b"\x88")
    assert [_is_hidden("vp9", packet) for packet in packets] == [False, True, False, False, False]


# several at once


def test_several_threads_read_at_once_until_it_is_closed(folder: Path) -> None:
    path, expected = made(folder, "open_gop.mp4")
    frames, said, reads = Frames(path), list[str](), threading.Semaphore(0)
    frames._most = 20  # a small cache, so that they decode again and again

    def work(seed: int) -> None:
        try:
            for index in np.random.default_rng(seed).integers(0, len(expected), 10_000).tolist():
                check(frames.read(index), expected[index])
                reads.release()
        except BaseException as error:
            said.append(f"{type(error).__name__}: {error}")

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    assert all(reads.acquire(timeout=60) for _ in range(60))
    frames.close()
    for thread in threads:
        thread.join()
    frames.close()
    assert said == ["RuntimeError: these frames are closed; open them again"] * 4


# folders and refusals
