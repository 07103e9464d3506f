"""What the decoder inside of OpenCV complains of, which OpenCV itself does not tell.

FFmpeg conceals the errors of a damaged stream and goes on: its frames look whole to OpenCV, and only its log says that
they are not. The log is process-wide, is written by the decoder's own threads, and says something trivial of every
frame, so that it is heard by a function of some machine instructions that needs no lock of Python: it keeps messages of
errors and warnings by the address of their format, in a ring. Measured, it takes no time; a second decoding would.

`start` does nothing where the libavutil of OpenCV is not a file of its own (Windows), and where somebody wants to read
the log (OPENCV_FFMPEG_DEBUG, OPENCV_FFMPEG_LOGLEVEL). There, and where several videos are decoded at a time, errors
are looked for by `decoded_again`, with the ffmpeg program. So they are in VP8 and VP9, of whose errors FFmpeg's own
decoders notice next to nothing, and libvpx most.
"""

import atexit
import ctypes
import os
import re
import threading
from pathlib import Path

import numpy as np

from facetrack_cli.video import ffmpeg

_WARNING = 24  # libavutil's level of warnings; errors are lower
_RING = 1024  # messages that are kept between two looks
_NOTED = np.zeros(1 + _RING, np.int64)  # how many there were, then the last of them
# what is said in a warning, and means that data are missing
_MISSING = re.compile(r"Packet corrupt|Continuity check failed|PES packet size mismatch|corrupt decoded frame")
# what is said of a whole stream that begins in the middle of a group of pictures
_REFERENCE = re.compile(
    r"non-existing|no frame!|unref short failure|co located POCs|[Mm]issing reference|reference picture missing|"
    r"reference frames|Could not find ref|MVs not available"
)
_HARMLESS = re.compile(r"not implemented|upload a sample|[Dd]eprecated|APP fields|fmt:%s|Could not update timestamps")
_LINE = re.compile(r"^(?P<from>(?:\[[^\]]* @ \w+\] )+)\[(?P<level>\w+)\] (?P<text>.*)$")
BEGINNING = 32  # frames at the start of a clip in which references may be missing

_lock = threading.Lock()
_kept: list[object] = []  # what must live as long as the process
_tried = False


def start() -> bool:
    """Listen from now on, and after OpenCV has opened its first video; whether that is possible."""
    global _tried
    with _lock:
        if not _tried:
            _tried = True
            if os.environ.get("OPENCV_FFMPEG_LOGLEVEL") == "-8" and "OPENCV_FFMPEG_DEBUG" not in os.environ:
                _listen()
        return bool(_kept)


def noted() -> int:
    """How many messages there were until now."""
    return int(_NOTED[0])


def complaints(since: int, frame: int) -> list[str]:
    """The messages after the first `since` that mean damage, while the decoder was at this frame of its clip."""
    found, total = [], int(_NOTED[0])
    for at in range(max(since, total - _RING), total):
        word = int(_NOTED[1 + at % _RING])
        text = ctypes.string_at(word & (1 << 48) - 1).decode("utf-8", "replace")
        if is_damage(text, word >> 48 < _WARNING, frame):
            found.append(" ".join(text.split()))
    return found


def is_damage(text: str, error: bool, frame: int) -> bool:
    """Whether a message, an error or a warning, means that this frame or one soon after it is damaged."""
    if _HARMLESS.search(text) or (frame < BEGINNING and _REFERENCE.search(text)):
        return False
    return error or bool(_MISSING.search(text))


def decoded_again(path: Path, decoder: str = "", frames: int | None = None) -> list[str]:
    """What ffmpeg says of damage when it decodes a video, or its first `frames`, to nothing; () if it cannot be asked.

    `decoder` is one of ffmpeg's, else its default.
    """
    chosen = ("-c:v", decoder) if decoder else ()
    until = () if frames is None else ("-frames:v", str(frames))
    source = ("-v", "level+warning", *chosen, "-i", ffmpeg.source_argument(path), "-map", "0:v:0")
    try:
        said = ffmpeg.run([*source, *until, "-fps_mode", "passthrough", "-f", "null", "-"])[1]
    except (OSError, RuntimeError):
        return []
    lines = [_LINE.match(line) for line in said.splitlines()]
    words = [(found["text"], found["level"] != "warning") for found in lines if found and "null" not in found["from"]]
    return [text for text, error in words if is_damage(text, error, 0)]


def _listen() -> None:
    import cv2

    here = Path(cv2.__file__).parent
    places = [*here.parent.glob("opencv_*.libs/libavutil*"), *here.glob(".dylibs/libavutil*")]
    if len(places) != 1 or ctypes.sizeof(ctypes.c_void_p) != 8:
        return
    try:
        library = ctypes.CDLL(str(places[0]))
        function, engine = _function()
        library.av_log_set_callback(ctypes.c_void_p(function))
    except (ImportError, OSError, AttributeError, RuntimeError):
        return
    _kept.extend((library, engine))
    # the function goes before the decoder's threads do
    atexit.register(library.av_log_set_callback, ctypes.cast(library.av_log_default_callback, ctypes.c_void_p))


def _function() -> tuple[int, object]:
    """The address of `void (void *context, int level, const char *format, va_list)`, and what owns it."""
    from llvmlite import binding, ir

    whole, number = ir.IntType(64), ir.IntType(32)
    module = ir.Module()
    module.triple = binding.get_process_triple()
    # the last argument is a pointer wherever it is not read
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [whole, number, whole, whole]), "noted")
    _, level, text, _ = function.args
    entry, keep, done = (function.append_basic_block() for _ in range(3))
    build = ir.IRBuilder(entry)
    level = build.and_(level, number(255))  # without the colour
    build.cbranch(build.icmp_signed("<=", level, number(_WARNING)), keep, done)
    build.position_at_end(keep)
    first = build.inttoptr(whole(_NOTED.ctypes.data), whole.as_pointer())
    at = build.atomic_rmw("add", first, whole(1), "seq_cst")
    place = build.add(build.and_(at, whole(_RING - 1)), whole(1))
    word = build.or_(text, build.shl(build.zext(level, whole), whole(48)))
    build.store(word, build.gep(first, [place]))
    build.branch(done)
    build.position_at_end(done)
    build.ret_void()
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(binding.parse_assembly(str(module)), machine)
    engine.finalize_object()
    return engine.get_function_address("noted"), engine
