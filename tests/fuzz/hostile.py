"""Damage to bytes, texts and arrays: functions of a random.Random, the same for the same seed."""

from __future__ import annotations

import io
import re
import zipfile
from random import Random
from typing import Any

import numpy as np

NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "-0", "0", "0.0", "-1", "1e-320", "0.5", "1000000", "1_000",
    "0x10", "010", "１２", "٣", "1,5", "1e", "--1", "+5", "", "true", "no", "null", "[]", "{}", "[[[1]]]", "'1'", "*a",
    "&a 1", "~", "!!int x", "!!python/name:os.system x", str(2**31), str(2**63), str(10**40), "9" * 5000,
)  # fmt: skip
WORDS = (
    "", " ", "-", "--help", "\u202egnp.exe", "\u200b", "n\u0303ose", "\x1b[31mred", "\x07", "\x00", "\ufeff", "\u2028",
    "a" * 10_000, "../../../etc/passwd", "/", "%s%n", "{0}", "$(id)", "`", "'", '"', "💥" * 50, "nan", "null", "a/b",
    "a:b", "\\ud800", "\\u0000", "type", "frame", "box", "nose", "NOSE", "=1+1", "<script>alert(1)</script>", "|", ">",
    "%", "@",
)  # fmt: skip


def data(rng: Random, whole: bytes) -> bytes:
    """Bytes damaged once to three times."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        whole = _damaged(rng, whole)
    return whole


def _damaged(rng: Random, whole: bytes) -> bytes:
    a = rng.randrange(len(whole) + 1)
    b = min(len(whole), a + rng.choice((1, 2, 7, 64, 1000, len(whole) // 3 + 1)))
    flipped = bytearray(whole)
    for _ in range(min(len(whole), rng.choice((1, 1, 3, 30)))):
        flipped[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
    inserted = rng.choice((b"\0", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"\n\n", rng.randbytes(40)))
    text = whole.decode("utf-8", "replace")
    recoded = (text.encode("utf-16"), text.encode("utf-32"), text.encode("latin-1", "replace") + b"\xe9")
    lines = (b"\xef\xbb\xbf" + whole, whole.replace(b"\n", b"\r\n"), whole.replace(b"\n", b"\r"))
    others = (b"", b"\n", b"\0" * 1000, b"{}", b"[]", b"null", b"---\n", b"PK\x03\x04", b"%PDF-1.7\n", b"\x89PNG\r\n")
    return rng.choice((
        bytes(flipped), bytes(flipped), whole[:a], whole[:a], whole[:a] + whole[b:],
        whole[:b] + whole[a:b] * rng.choice((1, 2, 50)) + whole[b:],
        whole[:a] + rng.choice((b"\0", b"\xff")) * (b - a) + whole[b:],
        whole[:a] + inserted + whole[a:], rng.choice((*recoded, *lines)), rng.choice(others),
    ))  # fmt: skip


def text(rng: Random, whole: str) -> bytes:
    """A text with hostile numbers or words, or with damaged bytes."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        how = rng.choice(("number", "number", "word", "bytes"))
        if how == "bytes":
            return data(rng, whole.encode("utf-8", "surrogatepass"))
        pattern, values = (r"-?\d+(\.\d+)?", NUMBERS) if how == "number" else (r"[A-Za-z_]{2,}", WORDS)
        whole = _at(rng, pattern, whole, values)
    return whole.encode("utf-8", "surrogatepass")


def _at(rng: Random, pattern: str, whole: str, values: tuple[str, ...]) -> str:
    found = list(re.finditer(pattern, whole))
    if not found:
        return whole
    # places at the start are chosen more often: headers, and the first frames
    one = found[min(rng.randrange(len(found)), rng.randrange(len(found)))]
    return whole[: one.start()] + rng.choice(values) + whole[one.end() :]


class Opens:
    """What a pickle in a file would run: it writes a file named `pwned`."""

    def __reduce__(self) -> tuple[Any, ...]:
        return open, ("pwned", "w")


def npz(found: dict[str, np.ndarray], **lies: tuple[int, ...]) -> bytes:
    """An .npz of arrays, object arrays too; of those in `lies` the header says another shape."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, one in found.items():
            archive.writestr(f"{name}.npy", npy(np.asarray(one), lies.get(name)))
    return file.getvalue()


def npy(one: np.ndarray, shape: tuple[int, ...] | None = None) -> bytes:
    """An .npy of an array, whose header says `shape`."""
    file = io.BytesIO()
    if shape is None:
        np.lib.format.write_array(file, one, allow_pickle=True)
    else:
        header = {"descr": np.lib.format.dtype_to_descr(one.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(one.tobytes())
    return file.getvalue()
