"""What README and the guides say to type is typed, block after block in one folder, and prints what they show.

An HTML comment above a block, which readers do not see, says what they know from the text:
`<!-- first: COMMANDS -->` make the files that the block speaks of; `<!-- exit code N -->` is what it ends with;
`<!-- not typed: WHY -->` leaves it out, and what is shown below it. Each line of a block of `text` must be among what
the block above it has printed, its numbers within a fifth, within its spread (±), or any where they are times.
"""

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from pathlib import Path

import pytest
from imageio_ffmpeg import get_ffmpeg_exe

from facetrack_cli.core.models import VARIABLE
from tests.test_docs import FENCE, PAGES, ROOT

# README and two guides by day, with few frames; with `nightly` all pages, with whole clips and what is printed
BY_DAY = {
    "README.md": {},
    "film.md": {"RUN_STOP": "52"},  # until both people are there
    "signer.md": {"RUN_STOP": "40"},  # until a hand is corrected
}
SHORT = {"RUN_STOP": "12", "RUN_NO_VIDEO": "1", "COMPARE_STOP": "12", "COMPARE_SEEDS": "1", "EVAL_PARTIAL": "1"}
# measurements, most of them of clips that are not here; a reference; code that has its own tests
OTHERS = ("results.md", "python.md", "extending.md")
CLIPS = {"signer.md": "signing"}  # what clip.mp4 is there
# words of blocks that are typed where there is such a program or module
TOOLS = {"jq ": "jq", "| parallel": "parallel", "parquet": "pyarrow", "pandas": "pandas"}

FACETRACK = """#!/bin/sh
case " $* " in
*" --pick "* | *" --page "* | *" 0 --live "* | *" rtsp:"*) exit 0 ;;  # which somebody ends
*" --init "* | *" --import "*) ;;
*" fix "*) exit 0 ;;
esac
exec {python} -m facetrack_cli "$@"
"""
PYTHON = '#!/bin/sh\nexec {python} "$@"\n'
COMMENT = re.compile(r"<!-- (first|exit code|not typed):? ([^\n]*) -->\s*\Z")
INSTALL = re.compile(r"python3 -m venv \S+|\. \S+/activate|\S*pip (?:un)?install [^&\n]+")
TIMES = re.compile(r"[\d.,]+ +×[\d.,]+|[\d.,]+ (?:frames/s|s|ms|MB)\b")
NUMBER = re.compile(r"(?:\d[\d,]*)?\.?\d+(?: ± [\d.,]+)?")


def typed(page):
    """Language, text and comments of each block that is typed, and of those that show what is printed."""
    text, skipped = page.read_text(encoding="utf-8"), False
    for block in FENCE.finditer(text):
        comments, before = {}, text[: block.start()].rstrip(" ")
        while comment := COMMENT.search(before):
            comments[comment[1]] = comment[2]
            before = before[: comment.start()]
        if block[2] in ("sh", "python"):
            skipped = "not typed" in comments or "benchmarks/" in block[3] or lacks(block[3])
        if block[2] in ("sh", "python", "text") and not skipped and "not typed" not in comments:
            yield block[2], textwrap.dedent(block[3]), comments


def lacks(text):
    """Whether a block calls a program that is not on the PATH, or needs a module that is not installed."""
    return any(word in text and shutil.which(one) is None and find_spec(one) is None for word, one in TOOLS.items())


def cases():
    for page in PAGES:
        if page.name not in OTHERS and any(language != "text" for language, *_ in typed(page)):
            yield pytest.param(page, False, marks=pytest.mark.nightly, id=page.name)
            if page.name in BY_DAY:
                yield pytest.param(page, True, id=f"{page.name}, in short")


@pytest.fixture
def folder(tmp_path, facetrack):
    """A folder with files of the names that the pages use, and beside it the programs that they call."""
    samples, programs, here = ROOT / "sample_videos", tmp_path / "bin", Path.cwd()
    programs.mkdir()
    (here / "clips").mkdir()
    (here / "sample_videos").symlink_to(samples)
    for name in ("expressions", "occlusion"):
        for file in samples.glob(f"{name}.*"):
            shutil.copy(file, here / "clips")
    shutil.copy(samples / "expressions.mp4", here / "clip.mp4")
    for name, text in {"facetrack": FACETRACK, "python": PYTHON}.items():
        (programs / name).write_text(text.format(python=sys.executable))
        (programs / name).chmod(0o755)
    (programs / "ffmpeg").symlink_to(get_ffmpeg_exe())
    return here


def calls(command):
    """The arguments of each line of a block that calls facetrack alone; None of a block that takes a shell."""
    try:
        lines = [shlex.split(line, comments=True) for line in command.replace("\\\n", " ").splitlines()]
    except ValueError:  # a quotation that goes on in the next line
        return None
    lines = [words for words in lines if words]
    odd = {*"|&;<$*"}
    plain = (
        words[0] == "facetrack" and "2>" not in words and ">" not in words[:-2] and not odd & {*"".join(words)}
        for words in lines
    )
    return [words[1:] for words in lines] if all(plain) else None


def is_ended_by_hand(words):
    """Whether a command serves a page, or follows a camera."""
    page = {"--pick", "--page"} & {*words} or (words[0] == "fix" and not {"--init", "--import"} & {*words})
    return page or words[1:3] == ["0", "--live"] or any(word.startswith("rtsp:") for word in words)


def called(command, folder, facetrack):
    """Exit code and output of a block; in this process where facetrack is called alone: a start takes a second."""
    if (lines := calls(command)) is None:
        return bash(command, folder)
    code, printed = 0, ""
    for words in lines:
        if code or is_ended_by_hand(words):
            continue
        code, out, err = facetrack(*(words[:-2] if ">" in words else words))
        if ">" in words:
            Path(words[-1]).write_text(out)
        printed += out + err
    return code, printed


def bash(command, folder):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PATH": f"{folder.parent / 'bin'}:{os.environ['PATH']}"}
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL}
    words = ["bash", "-eo", "pipefail", "-c", command]
    done = subprocess.run(words, cwd=folder, env=environment, text=True, check=False, **both)
    early = "| head" in command and done.returncode == 141  # a reader that stops is no mistake
    return 0 if early else done.returncode, done.stdout


def executed(text):
    """Exit code and output of a block of Python, in this process."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(text, "a page", "exec"), {"__name__": "__main__"})
    return 0, out.getvalue()


def form(line):
    """A line without its numbers, and they: value, and how far another may be from it."""
    line, numbers = TIMES.sub("TIME", " ".join(line.split())), []
    for found in NUMBER.findall(line):
        value, _, spread = found.replace(",", "").partition(" ± ")
        last = 10.0 ** -len(value.partition(".")[2])
        numbers.append((float(value), max(abs(float(value)) / 5, 2 * last, 2 * float(spread or 0))))
    return re.sub("─+", "─", NUMBER.sub("#", line)), numbers


def is_printed(shown, printed):
    """Whether a line of a page is among those printed; `...` at its end stands for the rest."""
    words, numbers = form(shown.removesuffix("..."))
    for line in printed.splitlines():
        other, values = form(line)
        same = other.startswith(words) if shown.endswith("...") else other == words
        if same and all(abs(a - b) <= within for (a, within), (b, _) in zip(numbers, values, strict=False)):
            return True
    return not words


@pytest.mark.parametrize(("page", "short"), list(cases()))
def test_a_page_is_typed(page, short, folder, facetrack, monkeypatch, request):
    if short:
        request.getfixturevalue("no_plot")
    if page.name in CLIPS:
        shutil.copy(ROOT / "sample_videos" / f"{CLIPS[page.name]}.mp4", folder / "clip.mp4")
    printed = ""
    monkeypatch.setenv(VARIABLE, str(folder.parent / "models"))  # a page may get one
    for name, value in (SHORT | BY_DAY[page.name] if short else {}).items():
        monkeypatch.setenv(f"FACETRACK_{name}", value)
    for language, text, comments in typed(page):
        if language == "text":
            wrong = [] if short else [line for line in text.splitlines() if not is_printed(line, printed)]
            assert not wrong, f"{page.name} shows what is not printed:\n" + "\n".join(wrong) + f"\nbut:\n{printed}"
            continue
        if "first" in comments:
            code, printed = called(comments["first"], folder, facetrack)
            assert code == 0, f"{page.name}: {comments['first']}\n{printed}"
        command = INSTALL.sub("true", text)
        code, printed = called(command, folder, facetrack) if language == "sh" else executed(text)
        assert code == int(comments.get("exit code", 0)), f"{page.name}: {text}\n{printed}"
