"""A case from its name: the kind of input, and the seed of the damage to it; or one that is kept by its name.

In commands IN is the folder of valid inputs, and @ the file that is damaged.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import NamedTuple, TypeAlias

import click
import cv2
import numpy as np

from facetrack_cli.cli.app import COMMANDS, cli
from tests.fuzz import hostile
from tests.fuzz.bench import FRAMES, RECIPES, TRUTHS, Bench
from tests.fuzz.judge import Case

BOX = "--box 115,58,113,113"
RUN = "-o out --no-video -q --threads 1 --stop 3"
MIL = f"{BOX} --config mil"
TO = ("mot", "otb", "got10k", "vot", "coco", "dlc", "eaf")
Build: TypeAlias = Callable[[Random, Bench, Case], "str | list[str]"]  # the command line, its words if they hold blanks
Content: TypeAlias = Callable[[Random, Bench], bytes]


def build(name: str, bench: Bench, folder: Path) -> Case:
    """The case of a name such as `init-17`, its files written into `folder`. KeyError for a kind that there is not."""
    case = Case(name, folder)
    make = NAMED.get(name) or KINDS[name.rpartition("-")[0]]
    line = make(Random(name), bench, case)
    words = line.split(" ") if isinstance(line, str) else line
    case.argv = [word.replace("IN", str(bench.folder), 1) if word.startswith("IN/") else word for word in words]
    return case


def names(count: int, first: int = 0) -> list[str]:
    """The names of `count` cases, of all kinds in turn, from the seed `first` on."""
    kinds = list(KINDS)
    return [f"{kinds[i % len(kinds)]}-{first + i // len(kinds)}" for i in range(count)]


# --- a damaged file, and what reads it --------------------------------------------------------------------------------


def texts(*names: str) -> Content:
    return lambda rng, bench: hostile.text(rng, bench.text(rng.choice(names)))


def trees(*names: str) -> Content:
    """Texts that are trees too, damaged as one or the other."""

    def content(rng: Random, bench: Bench) -> bytes:
        name = rng.choice(names)
        text = rng.random() < 0.6
        return hostile.text(rng, bench.text(name)) if text else hostile.tree(rng, bench.tree(name))

    return content


def arrays(name: str) -> Content:
    return lambda rng, bench: hostile.arrays(rng, bench.arrays(name))


class Damaged(NamedTuple):
    """A file of one of these names, below `run/` one of a run's folder, and the commands that read it."""

    names: Sequence[str]
    content: Content
    commands: Sequence[str]

    def __call__(self, rng: Random, bench: Bench, case: Case) -> str:
        command, name = rng.choice(self.commands), rng.choice(self.names)
        if "run" in command.split()[1:] or name.startswith("run/"):
            shutil.copytree(bench.path("run"), case.folder / "run")
        case.put(name, self.content(rng, bench))
        beside = (word.rpartition("/")[2] for word in command.split() if word.startswith(("--", "IN/", "run")))
        case.named = (*case.named, *beside)
        if "--rename" in command or "--merge" in command or "--split" in command:  # which it corrects
            case.files = {}
        return command.replace("@", name)


ROWS = [
    *(f"export @ --to {to} -o {out}" for to in TO for out in ("-", "out.txt")),
    *(f"eval @ --truth IN/truth.csv{more}" for more in ("", " --partial", " --json out.json", " --csv -") * 3),
    *("plot @ -o out.png --dpi 40",) * 2,
]
PEOPLE = ("--json", "--csv", "--rename face=Ann", "--merge face=face", "--split face@2f", "")
RUNS = ["fix run --init IN/corrected.init.yaml --no-video -q"] * 4 + ["report run -o out.html -q"]
OF = ("factorized", "factorized_robust", "histogram", "mosse", "head_hands", "signer")
KINDS: dict[str, Build] = {
    "init": Damaged(
        ("x.init.yaml", "x.init.json"),
        trees("corrected.init.yaml"),
        [*(f"run IN/frames --init @ --config {one} {RUN}" for one in OF), *("fix run --init @ --no-video -q",) * 3],
    ),
    "recipe": Damaged(
        ["x.yaml"],
        trees(*(f"{name}.yaml" for name in RECIPES)),
        ["recipes check @"] * 4 + [f"run IN/frames --config @ {BOX} {RUN} --stop 2 --gallery IN/gallery.npz"],
    ),
    "csv": Damaged(["trajectory.csv"], texts(*(f"{of}/trajectory.csv" for of in ("run", "box", "box2"))), ROWS),
    "json": Damaged(["trajectory.json"], trees(*(f"{of}/trajectory.json" for of in ("run", "box", "box2"))), ROWS),
    "jsonl": Damaged(["trajectory.jsonl"], texts("run/trajectory.jsonl"), ROWS),
    "results": Damaged(
        ["results.txt"],
        texts(*(TRUTHS[kind] for kind in ("otb", "got10k", "mot", "vot", "boxes"))),
        [f"eval @ --truth IN/boxes.csv{more}" for more in ("", " --format otb", " --format mot", " --format vot")],
    ),
    "gallery": Damaged(
        ["x.npz"],
        arrays("gallery.npz"),
        [f"run IN/frames --config adaptive_recognition --gallery @ {BOX} {RUN}"] * 5 + ["gallery show @ -o out.png"],
    ),
    "prior": Damaged(
        ["x.npz"],
        arrays("prior.npz"),
        [f"run IN/frames --config factorized --set prior.file=@ {RUN}"] * 2 + ["prior show @ -o out.png"],
    ),
    "calibration": Damaged(
        ["x.json"],
        trees("calibration.json"),
        [f"run IN/frames --config factorized --set confidence.calibration=@ {RUN}"],
    ),
    "rows": Damaged(["run/trajectory.csv"], texts("run/trajectory.csv"), RUNS),
    "header": Damaged(["run/trajectory.json"], trees("run/trajectory.json"), RUNS),
    "drawn": Damaged(
        ["run/annotated.mp4"],
        lambda rng, bench: hostile.data(rng, bench.path("run/annotated.mp4").read_bytes()),
        RUNS,
    ),
    "people": Damaged(
        ["run/people.json"],
        trees("people.json"),
        [*(f"people run --no-video -q {words}".rstrip() for words in PEOPLE), *("report run -o out.html -q",) * 2],
    ),
    "video": Damaged(  # tiny files that are no video; damaged ones have a corpus of their own
        [f"clip{suffix}" for suffix in (".mp4", ".avi", ".mkv", ".png", ".txt", ".npz", "")],
        lambda rng, bench: hostile.data(rng, b"\0\0\0\x20ftypisom" * 9),
        [f"run @ {BOX} {RUN}", "init @ -o out.yaml"],
    ),
}


def _kind(make: Build) -> Build:
    KINDS[make.__name__.strip("_")] = make
    return make


@_kind
def _set(rng: Random, bench: Bench, case: Case) -> list[str]:
    keys = "filter.particles motion.sigma likelihood.sigma confidence.calibration prior.file seed x.y "
    value = rng.choice(hostile.NUMBERS + hostile.WORDS)
    override = f"{rng.choice(keys.split(' '))}={value}".replace("\x00", "")
    return ["recipes", "check", rng.choice(list(RECIPES)), "--set", override]


@_kind
def _truth(rng: Random, bench: Bench, case: Case) -> str:
    kind = rng.choice(list(TRUTHS))
    form = rng.choice(("", f" --truth-format {kind}", f" --truth-format {rng.choice(list(TRUTHS))}"))
    if kind == "pts":
        shutil.copytree(bench.path("pts"), case.folder / "pts")
        number = rng.choice(("000001", "000003", "0", "99999999999999999999", "x"))
        file = case.put(f"pts/{number}.pts", hostile.text(rng, bench.text("pts/000001.pts")))
        case.named, file = (*case.named, "pts"), rng.choice((file, "pts"))
    else:
        file = case.put(TRUTHS[kind], hostile.text(rng, bench.text(TRUTHS[kind])))
    if kind == "facetrack" and rng.random() < 0.2:
        return f"prior fit {file} -o out.npz"
    ours = "run" if kind in ("facetrack", "pts") else "box"
    return f"eval IN/{ours} --truth {file}{form}{rng.choice(('', ' --partial', ' --shift 1'))}"


@_kind
def _golden(rng: Random, bench: Bench, case: Case) -> str:
    (case.folder / "clips").mkdir()
    shutil.copy(bench.path("clip.mp4"), case.folder / "clips" / "occlusion.mp4")
    file = "goldens/occlusion.factorized.json"
    case.put(f"clips/{file}", trees(file)(rng, bench))
    case.named = (*case.named, "clips", "occlusion")
    return "regress clips -q"


@_kind
def _image(rng: Random, bench: Bench, case: Case) -> list[str]:
    content = bench.path("frames/1.png").read_bytes()
    if rng.random() < 0.4:
        import cv2

        picture = cv2.imread(str(bench.path("frames/1.png")))
        changed = rng.choice(
            (picture[:1, :1], picture[:, :7], picture[..., 0], picture.astype(np.uint16) * 257, picture * 0)
        )
        content = cv2.imencode(rng.choice((".png", ".jpg", ".bmp", ".tiff")), changed)[1].tobytes()
    if rng.random() < 0.2:
        file = io.BytesIO()
        np.save(file, np.zeros(3))
        content = file.getvalue()
    content = hostile.data(rng, content) if rng.random() < 0.7 else content
    if rng.random() < 0.3:
        shutil.copytree(bench.path("people"), case.folder / "people")
        case.put(f"people/anna/{rng.choice(('1.jpg', 'z.png', '..jpg'))}", content)
        case.named = (*case.named, "people")
        return ["gallery", "fit", "people", "-o", "out.npz", "-q"]
    shutil.copytree(bench.path("frames"), case.folder / "frames")
    case.put(f"frames/{rng.choice(('0', '1', '1', '00', '-1', '9' * 30, 'x', '1.2'))}.png", content)
    case.named = (*case.named, "frames")
    return ["run", "frames", "--init", str(bench.path("frames.init.yaml")), "--config", "factorized", *RUN]


@_kind
def _place(rng: Random, bench: Bench, case: Case) -> list[str]:
    """Something else stands where a file is to be."""
    name = "x" + rng.choice((".yaml", ".json", ".csv", ".npz", ".txt", ".mp4", ".png", ".jsonl", ""))
    path, how = case.folder / name, rng.randrange(8)
    case.named = (name,)
    if how == 0:
        path.mkdir()
    elif how == 1:
        path.symlink_to(name)
    elif how == 2:
        path.symlink_to("nowhere")
    elif how == 3:
        path.write_bytes(b"")
    elif how == 4:
        path.write_text("x")
        path.chmod(0)
    elif how == 5:
        long = ("x" * 300 + ".csv", "x/" * 3000 + "x.csv")
        name = rng.choice((*long, "", " ", "\udcff.csv", "x\ny.csv", "\x1b[31m.csv", "~", "/proc/self/mem"))
        case.named = ()
    elif how == 6:
        name = "x/y/z" + path.suffix
        path.with_name("x").write_text("a file")
        case.named = ("x/y",)
    else:
        case.named = (name,)  # nothing
    if os.sep not in name and how == 5 and rng.random() < 0.5 and 0 < len(name) < 99:
        (case.folder / name).write_text("frame,x,y\n")
    return _reading(rng, bench, name)


def _reading(rng: Random, bench: Bench, name: str) -> list[str]:
    """Any command, told to read `name`."""
    run, clip, truth = (str(bench.path(one)) for one in ("run", "frames", "truth.csv"))
    one = f"run {clip} --config factorized --no-video -q --threads 1 --stop 3"
    every = f"""
        {one} --init @
        {one} --set prior.file=@
        {one} --set confidence.calibration=@
        {one} --gallery @
        run {clip} --no-video -q --stop 3 --config @
        run {clip} --no-video -q --stop 3 --config adaptive_recognition --box 115,58,113,113 --gallery @
        run @ --no-video -q --stop 3
        recipes check @
        recipes show @
        init @
        prior show @
        prior fit @
        gallery show @
        gallery fit @
        eval @ --truth {truth}
        eval {run} --truth @
        export @ --to mot
        export {run} --to coco -o out.json --media @
        plot @
        plot {run} -o out.png --truth @
        report @
        report {run} -o out.html --clip @
        fix @ --init {truth}
        fix {run} --init @
        regress @
        compare @ --config sir
        compare {clip} --config mil --stop 2 --truth @
    """
    return [word.replace("@", name) for word in rng.choice(every.strip().splitlines()).split()]


_PAGE = {"pick", "browse", "debug", "help", "version"}
_WORK = {"seeds", "jobs"}  # to ask for a million runs is no fault


@_kind
def _arguments(rng: Random, bench: Bench, case: Case) -> list[str]:
    """A command that is right, and options of it that are not."""
    run, clip, truth = (str(bench.path(one)) for one in ("run", "frames", "truth.csv"))
    begins = f"""
        run {clip} --no-video -q --threads 1 --stop 3 -o out
        run {clip} --box 115,58,113,113 --no-video -q --threads 1 --stop 3 -o out
        init {clip} --box 115,58,113,113 -o out.yaml
        eval {run} --truth {truth}
        plot run
        export run --to {rng.choice(TO)}
        report run
        fix run --init {bench.path("corrected.init.yaml")}
        recipes check sir
        regress {bench.folder}
        prior fit {truth}
        prior show {bench.path("prior.npz")} -o out.png
        gallery fit {bench.path("people")}
        gallery show {bench.path("gallery.npz")} -o out.png
        compare {clip} --stop 2 --seeds 2
    """
    argv = rng.choice(begins.strip().splitlines()).split()
    if argv[1] == "run":  # what is written goes into the case's folder
        shutil.copytree(bench.path("run"), case.folder / "run")
    known = cli.get_command(click.Context(cli), argv[0])
    if isinstance(known, click.Group):
        known = known.get_command(click.Context(known), argv[1])
    assert known is not None
    options = [one for one in known.params if isinstance(one, click.Option) and not _PAGE & {one.name}]
    for one in rng.choices(options, k=rng.choice((1, 1, 2, 4))):
        argv = [*argv, rng.choice(one.opts)]
        if not one.is_flag and rng.random() < 0.97:
            argv.append(_value(rng, one))
    if rng.random() < 0.1:
        argv = [one for one in argv if rng.random() < 0.8] or ["x"]
    return argv


def _value(rng: Random, one: click.Option) -> str:
    if one.name == "out":  # within the case's folder
        odd = ("", "-", "/dev/null", "/dev/full", ".", "x" * 300, "x/" * 3000, "\udcff", "x\ny", "\x1b[31m")
        return rng.choice((*odd, "out", "a/b/c", "x.png", "x.npz", "x.yaml"))
    if one.name in _WORK:
        return rng.choice(("0", "-1", "nan", "", "1.5", "x", "9" * 400, "2"))
    numbers = ("1e9", "0.1", "1/0", "1/3000", "3", "-1,-1,5,5", "1,2,3,4", "0,0,0,0", "1,2,nan,4", "1,2,3")
    return rng.choice((*numbers, *hostile.NUMBERS, *hostile.WORDS)).replace("\x00", "")


@_kind
def _words(rng: Random, bench: Bench, case: Case) -> list[str]:
    """Words that are no command line."""
    words = [*hostile.WORDS, *COMMANDS, "fit", "show", "check", "--set", "-o", "--", "-j"]
    given = [rng.choice(words).replace("\x00", "") for _ in range(rng.randrange(1, 6))]
    return [one for one in given if one not in ("--help", "-h")]


# --- kept by name: what no seed is likely to find, or what was found once ---------------------------------------------

NAMED: dict[str, Build] = {}

# command lines of their own: what an error must name, and the command

LINES = {
    "recipe-that-never-ends": ("", "recipes check /dev/zero"),
    "name-that-is-too-long": ("", f"eval {'x' * 300}.csv --truth IN/truth.csv"),
    "output-whose-path-is-too-long": ("", f"run IN/frames {MIL} -o {'x/' * 3000}"),
    "command-that-colours-the-terminal": ("", "\x1b]0;x\x07run"),
    "output-that-colours-the-terminal": ("", "plot IN/run -o \x1b]0;x\x07.png"),
    "one-frame-in-an-hour": ("", f"run IN/frames --fps 1/3600 {MIL} -o out -q --stop 3"),
    "frame-number-beyond-any-clip": ("", f"run IN/frames {MIL} -o out --init-frame {'9' * 30}"),
}
for name, (said, command) in LINES.items():

    def _command(rng: Random, bench: Bench, case: Case, said: str = said, command: str = command) -> str:
        case.named = (said,) if said else ()
        return command

    NAMED[name] = _command

# commands that read a file: its name, its text, and the command

ALIASES = "a0: &a0 [x, x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
HEAD = "frame,time_s,target,part,x,y"
APART = "0,0,face,box,10,10,5,5,tracked\n1000000000,1,face,box,10,10,5,5,lost\n"
FACES = "".join(f"{t},{t / 25},face{i},nose,{i},10\n" for t in range(FRAMES) for i in range(1000))
COLOURED = "".join(f"{t},{t / 25},\x1b[31mface\x07,nose,10,10\n" for t in range(FRAMES))
TEXTS = {
    "recipe-of-aliases-of-aliases": ("x.yaml", ALIASES, "recipes check x.yaml"),
    "recipe-that-calls-python": (
        "x.yaml",
        "description: !!python/object/apply:os.system ['touch pwned']\n",
        "recipes check x.yaml",
    ),
    "recipe-of-9000-unknown-keys": ("x.yaml", "".join(f"key{i}: {i}\n" for i in range(9000)), "recipes check x.yaml"),
    "recipe-nested-100000-deep": ("x.yaml", f"a: {'[' * 100_000}{']' * 100_000}", "recipes check x.yaml"),
    "trajectory-nested-100000-deep": ("x.json", '{"a":' * 100_000 + "1" + "}" * 100_000, "export x.json --to dlc"),
    "line-of-20-megabytes": ("x.jsonl", f'{{"type":"header","a":"{"a" * 20_000_000}"}}\n', "export x.jsonl --to dlc"),
    "frames-a-thousand-million-apart": ("x.csv", f"{HEAD},w,h,status\n{APART}", "export x.csv --to otb -o out.txt"),
    "plot-of-frames-a-thousand-million-apart": ("x.csv", f"{HEAD},w,h,status\n{APART}", "plot x.csv -o out.png"),
    "truth-of-a-thousand-targets": ("x.csv", f"{HEAD}\n{FACES}", "eval IN/run --truth x.csv"),
    "names-that-colour-the-terminal": ("x.csv", f"{HEAD}\n{COLOURED}", "eval IN/run --truth x.csv"),
}
for name, (file, text, command) in TEXTS.items():

    def _text(rng: Random, bench: Bench, case: Case, file: str = file, text: str = text, command: str = command) -> str:
        case.put(file, text.encode())
        if "IN/run " in command:
            case.named = (file, "run")
        return command

    NAMED[name] = _text


def _case(make: Callable[[Bench, Case], str]) -> None:
    NAMED[make.__name__.strip("_").replace("_", "-")] = lambda _, bench, case: make(bench, case)


@_case
def _calibration_with_a_list_for_a_name(bench: Bench, case: Case) -> str:
    tree = bench.tree("calibration.json")
    tree["maps"]["points"]["method"] = ["isotonic"] * 500
    case.put("x.json", json.dumps(tree).encode())
    return f"run IN/frames --config factorized --set confidence.calibration=x.json {RUN}"


@_case
def _gallery_that_is_a_pickle(bench: Bench, case: Case) -> str:
    arrays = bench.arrays("gallery.npz")
    opens = np.array([hostile.Opens()], object)
    case.put("x.npz", hostile.npz({**arrays, "names": opens, "format": opens}))
    return "gallery show x.npz -o out.png"


@_case
def _prior_whose_header_promises_much(bench: Bench, case: Case) -> str:
    case.put("x.npz", hostile.npz(bench.arrays("prior.npz"), shapes=(10**9, 5, 2)))
    return "prior show x.npz -o out.png"


def _png(width: int, height: int) -> bytes:
    """A black grey image."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(width + 1)) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@_case
def _image_of_400_million_pixels(bench: Bench, case: Case) -> str:
    case.put("frames/0.png", _png(20_000, 20_000))
    return f"run frames {MIL} {RUN}"


@_case
def _image_one_pixel_high(bench: Bench, case: Case) -> str:
    case.put("frames/0.png", _png(60_000, 1))
    case.named = ("--box",)
    return f"run frames {MIL} {RUN}"


@_case
def _image_with_damaged_metadata(bench: Bench, case: Case) -> str:
    """Pillow warns of it on standard error."""
    exif = b"Exif\0\0II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\xff\xff\0\0\x01\0"
    whole = cv2.imencode(".jpg", cv2.imread(str(bench.path("frames/0.png"))))[1].tobytes()
    case.put("frames/0.jpg", whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:])
    return f"run frames {MIL} {RUN}"


@_case
def _run_folder_linked_to_itself(bench: Bench, case: Case) -> str:
    shutil.copytree(bench.path("run"), case.folder / "run")
    (case.folder / "run" / "trajectory.json").unlink()
    (case.folder / "run" / "trajectory.json").symlink_to("trajectory.json")
    return "report run -o out.html -q"


@_case
def _file_name_that_colours_the_terminal(bench: Bench, case: Case) -> str:
    case.put("\x1b]0;x\x07\x1b[31m.csv", b"frame,x,y\n")
    case.named = ()
    return "eval \x1b]0;x\x07\x1b[31m.csv --truth IN/truth.csv"
