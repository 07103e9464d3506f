"""Annotated frames to an MP4 that plays everywhere: H.264, yuv420p, the source's times and the source's sound.

Every frame keeps its own time, and none is repeated. Times within a millisecond of the nominal rate's grid are moved
onto it, so that a clip of constant rate comes out with a strictly constant one. The sound is copied in a second pass:
if that fails, there is still the video.

A video may be `cut` into pieces that are encoded by themselves and joined at the end. A piece that is finished stays
where it is whatever ends the program, and the video goes on from there.
"""

import contextlib
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.files import discard, publish, sync, temporary_path
from facetrack_cli.core.types import Image
from facetrack_cli.video import ffmpeg
from facetrack_cli.video.decode import FORMATS, sound_of
from facetrack_cli.video.encoder import Encoder, as_mp4

_COPIED_AUDIO = frozenset(("aac", "mp3", "ac3", "eac3", "alac"))  # what players expect in an MP4; the rest becomes AAC
_KNOWN = ("-protocol_whitelist", "file", "-format_whitelist")  # as PyAV opens a clip
_SNAP_S = 0.0011  # containers that keep whole milliseconds move a frame by up to half of one, at either end
_LONGEST = 2**29  # ticks that a frame is shown at most: an MP4 holds 2**31, over several frames that are reordered
_SLOW_S = 60  # frames that are shown for longer have a coarser clock


class Cut(NamedTuple):
    """Where a video stands after some frames: what it goes on from. `pieces` are the ticks at which they begin."""

    frames: int = 0
    first_s: float = 0.0
    left_out_s: float = 0.0
    last_tick: int = 0
    pieces: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()


class VideoWriter(contextlib.AbstractContextManager["VideoWriter"]):
    """Writes BGR frames of `size` (width, height) to an MP4 at `path`, which appears there when `close` is called.

    `fps` is the nominal rate. `audio_from` is the clip whose sound is kept, from the first frame written to the end of
    the last. Odd sizes are padded by one black line or column, which H.264 requires. With `replace=False` the finished
    file stays `beside` its path. Pieces go to the folder `pieces`; those of a video that was written up to a `Cut` are
    there. `aspect` is the width of a pixel over its height. `warnings` (one line each) says what could not be
    kept, `published` whether the file is at `path`. Raises OutputError when the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        fps: Fraction,
        aspect: Fraction = Fraction(1),
        *,
        audio_from: Path | None = None,
        replace: bool = True,
        pieces: Path | None = None,
        after: Cut = Cut(),  # noqa: B008 -- it cannot be changed
    ):
        self.path, self.size, self.warnings = path, size, list(after.warnings)
        self._fps, self._audio_from, self._replace, self._folder = fps, audio_from, replace, pieces
        self._aspect = aspect
        # ticks of the file's clock: a frame lasts a whole number of them, and a tick at most 0.1 ms
        finest = 10_000 if fps * _SLOW_S > 1 else 1000
        self._timescale = fps.numerator * -(-finest // fps.numerator)
        self._frames, self._first_s, self._left_out_s, self._last_tick = after[:4]
        self._pieces, self._number = list(after.pieces), 0  # where they begin, and which one is written
        self._encoder: Encoder | None = None
        self._failed: OutputError | None = None
        self.published = self._closed = False
        if not self._pieces:
            self._start()

    def write(self, image: Image, time_s: float) -> None:
        """Append one (H, W, 3) uint8 BGR frame, shown from `time_s` on the source's clock; times must not fall."""
        width, height = self.size
        if self._closed:
            raise ValueError("write to a closed VideoWriter")
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(f"frame is {image.dtype} {image.shape}, the video takes uint8 {(height, width, 3)}")
        if self._failed is not None:
            raise self._failed
        if self._frames == 0:
            self._first_s = time_s
        time_s -= self._left_out_s
        elapsed_s = time_s - self._first_s
        nearest = round(elapsed_s * self._fps) / self._fps
        on_grid = abs(float(nearest) - elapsed_s) <= min(_SNAP_S, 0.25 / float(self._fps))
        tick = int(nearest * self._timescale) if on_grid else round(elapsed_s * self._timescale)
        if self._frames:
            tick = max(tick, self._last_tick + 1)
            if (beyond := tick - self._last_tick - _LONGEST) > 0:
                tick -= beyond
                self._left_out_s += beyond / self._timescale
                if not self.warnings:
                    gap = f"{(beyond + _LONGEST) / self._timescale / 3600:.1f} hours at {time_s:.0f} s"
                    shown = f"{_LONGEST / self._timescale / 3600:.1f}, which is the longest in an MP4"
                    self.warnings.append(f"{self.path}: a gap of {gap} is shown as {shown}")
        if self._encoder is None:
            self._start()
        if len(self._pieces) == self._number:
            self._pieces.append(tick)
        assert self._encoder is not None
        try:
            self._encoder.write(image, (tick - self._pieces[-1]) / self._timescale)
        except OutputError:
            self._closed = True
            raise
        self._last_tick = tick
        self._frames += 1

    def cut(self) -> tuple[Cut, Callable[[], None]]:
        """End a piece: where the video stands then, and what finishes the piece, in any thread, before `close`."""
        ended, number = self._encoder, self._number
        assert ended is not None and self._folder is not None
        folder = self._folder

        def finish() -> None:
            try:
                ended.end()
                ended.drop()
                folder.mkdir(exist_ok=True)
                sync(ended.target)
                ended.target.replace(_piece(folder, number))
                sync(folder)
            except OutputError as e:
                self._failed = e
                raise
            except OSError as e:
                self._failed = OutputError(f"{self.path}: {reason(e)}; choose another output folder")
                raise self._failed from e

        self._encoder, self._number = None, number + 1
        place = Cut(
            self._frames, self._first_s, self._left_out_s, self._last_tick, tuple(self._pieces), tuple(self.warnings)
        )
        return place, finish

    def close(self) -> None:
        """Finish the file and put it at `path`; closing again does nothing. Without any frame there is no file."""
        if self._frames == 0:
            self.discard()
        if self._closed:
            return
        self._closed = True
        whole = False
        try:
            if self._failed is not None:
                raise self._failed
            if self._encoder is not None:
                try:
                    self._encoder.end()
                except OutputError:
                    raise
                except BaseException:  # it needs only a moment more; a second interruption drops the video
                    with contextlib.suppress(OutputError):
                        self._encoder.end()
                    whole = self._encoder.whole and len(self._pieces) == 1
                    raise
            if len(self._pieces) > 1 or self._encoder is None:
                self._join()
            whole = True
            self._add_audio()
        finally:
            self._drop(keep=whole)
            if whole and self._replace:
                try:
                    publish(self.path)
                    self.published = True
                except OSError as error:
                    discard(self.path)
                    raise OutputError(f"{self.path}: {reason(error)}; choose another output folder") from error

    def discard(self) -> None:
        """Stop the encoder and leave no file, whatever stood at `path` before stays; does nothing once closed."""
        if not self._closed:
            self._closed = True
            self._drop()

    def __exit__(self, *_: object) -> None:
        self.close()  # what was written until an interruption is kept too

    @property
    def _target(self) -> Path:
        return temporary_path(self.path)

    def _start(self) -> None:
        """Start the encoder of the next piece; that of the first one writes what may be the whole video."""
        self._number = len(self._pieces)
        target = self._target if self._number == 0 else self._target.with_suffix(f".{self._number}.mp4")
        self._encoder = Encoder(self.path, target, self.size, self._fps, self._timescale, self._aspect)

    def _join(self) -> None:
        """Put the pieces together, each at its time."""
        assert self._folder is not None
        files = [_piece(self._folder, number) for number in range(len(self._pieces))]
        names = self._target.with_suffix(".pieces.txt")
        try:
            if self._encoder is not None:
                self._encoder.target.replace(files[-1])
            lines = ["ffconcat version 1.0"]
            for file, begin, end in zip(files, self._pieces, [*self._pieces[1:], None], strict=True):
                lines.append("file '" + ffmpeg.source_argument(file).replace("'", r"'\''") + "'")
                if end is not None:
                    lines.append(f"duration {(end - begin) / self._timescale:.6f}")
            names.write_text("\n".join(lines) + "\n", encoding="utf-8")
            command = ["-v", "error", "-y", "-f", "concat", "-safe", "0", *_KNOWN, f"concat,{FORMATS}"]
            command += ["-i", ffmpeg.source_argument(names)]
            command += ["-map", "0:v:0", "-c", "copy", *as_mp4(self._target, self._timescale)]
            code, said = ffmpeg.run(command)
        except (OSError, RuntimeError) as error:
            raise OutputError(f"{self.path}: {reason(error)}; choose another output folder") from error
        finally:
            names.unlink(missing_ok=True)
        if code:
            why = ffmpeg.cause(said) or f"ffmpeg ended with code {code}"
            raise OutputError(f"{self.path}: the video cannot be put together ({why}); free some space or run it again")

    def _add_audio(self) -> None:
        """Add the source's sound to the video just written; without it, a warning."""
        source, silent = self._audio_from, self._target
        if source is None or not source.is_file():
            return
        mixed = silent.with_suffix(".audio.mp4")
        try:
            codec, late_s = sound_of(source)
            if not codec:
                return
            start = self._first_s + late_s
            length = float((self._last_tick - self._pieces[0]) / Fraction(self._timescale) + 1 / self._fps)
            command = ["-v", "error", "-y", "-i", ffmpeg.source_argument(silent)]
            command += ["-itsoffset", f"{-start:.6f}", *_KNOWN, FORMATS, "-i", ffmpeg.source_argument(source)]
            command += ["-map", "0:v:0", "-map", "1:a:0", "-map_metadata", "-1", "-c:v", "copy"]
            # copying drops what comes before time 0 by itself
            recode = ["-af", "atrim=start=0", "-c:a", "aac", "-b:a", "160k"]
            command += ["-c:a", "copy"] if codec in _COPIED_AUDIO else recode
            code, said = ffmpeg.run([*command, "-t", f"{length:.6f}", *as_mp4(mixed, self._timescale)])
            if code:
                raise RuntimeError(ffmpeg.cause(said))
            mixed.replace(silent)
        except (OSError, RuntimeError, ValueError) as error:
            why = reason(error)
            self.warnings.append(f"{self.path}: written without sound, that of {source} cannot be used ({why})")
        finally:
            mixed.unlink(missing_ok=True)

    def _drop(self, *, keep: bool = False) -> None:
        """End the encoder, and unless `keep` remove the file."""
        if self._encoder is not None:
            self._encoder.drop()
            if self._encoder.target != self._target:
                self._encoder.target.unlink(missing_ok=True)
        if not keep:
            discard(self.path)


def _piece(folder: Path, number: int) -> Path:
    return folder / f"{number:05}.mp4"
