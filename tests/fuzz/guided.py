"""Fuzzers that are guided by coverage: `python -m tests.fuzz.guided PARSER [SECONDS]`, which takes atheris.

Each parser reads bytes as a command reads a file of somebody else. It takes them, or refuses them in one line: anything
else that it raises is a fault. atheris writes what found it to `crash-...` in the working directory.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from random import Random

ROOT = Path(__file__).parents[2]
SECONDS = 600
FEW = 3  # images of a pipe


def parsers() -> dict[str, Callable[[Path, bytes], object]]:
    """By name; each gets an empty folder, and bytes. The package is loaded here, under atheris if that guides."""
    from facetrack_cli.core.errors import InputError
    from facetrack_cli.core.npz import restore
    from facetrack_cli.engine.confidence import load_calibration
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.run_folder import lease
    from facetrack_cli.run_folder.manifest import read_manifest, recover_interrupted
    from facetrack_cli.runs.live import piped
    from facetrack_cli.runs.record import KIND
    from facetrack_cli.start.init_file import read_init
    from facetrack_cli.trackers.appearance.gallery import load_gallery
    from facetrack_cli.trackers.people.descriptor import load_people
    from facetrack_cli.trackers.points.shape_prior import load_prior
    from facetrack_cli.trajectory.people import read_people, read_still
    from facetrack_cli.trajectory.reader import read_header, read_trajectory

    def put(folder: Path, name: str, data: bytes) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    def people(folder: Path, data: bytes) -> None:
        put(folder, "people.json", data)
        if found := read_people(folder):
            found.seconds_together()
            for one in (*found.people, *found.tracks):
                assert read_still(folder, one.still) == b""

    def arrays(folder: Path, data: bytes) -> None:
        path = put(folder, "x.npz", data)
        state = partial(KIND.read, make=lambda stored: restore("run", stored.file))
        for read in (load_gallery, load_people, load_prior, state):
            with contextlib.suppress(InputError):
                read(path)

    def init(folder: Path, data: bytes) -> None:
        read_init(put(folder, f"x.{'yaml' if data[:1] != b'{' else 'json'}", data))

    def trajectory(folder: Path, data: bytes) -> None:
        rows = read_trajectory(put(folder, "x", data))
        if rows.header:
            read_header(rows)

    def run(folder: Path, data: bytes) -> None:
        note, _, manifest = data.partition(b"\n\n")
        put(folder, lease.NOTE, note)
        put(folder, "run.json", manifest)
        recover_interrupted(folder)
        read_manifest(folder)

    return {
        "people": people,
        "arrays": arrays,
        "live": lambda folder, data: list(islice(piped(io.BytesIO(data)), FEW)),
        "init": init,
        "trajectory": trajectory,
        "recipe": lambda folder, data: load_recipe(str(put(folder, "x.yaml", data))),
        "calibration": lambda folder, data: load_calibration(put(folder, "x.json", data)),
        "run": run,
    }


def taken(parse: Callable[[Path, bytes], object], data: bytes) -> bool:
    """Whether the bytes are taken; False if they are refused as they should be."""
    from facetrack_cli.core.errors import InputError, UsageError, flat

    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="facetrack-fuzz-", dir=memory if memory.is_dir() else None) as place:
        folder = Path(place, "folder")
        folder.mkdir()
        try:
            parse(folder, data)
            return True
        except (InputError, UsageError) as refused:
            assert flat(str(refused))
            return False
        finally:
            assert [*Path(place).iterdir()] == [folder], "nothing is written beside the folder"


def seeds(parser: str) -> Iterator[bytes]:
    """Whole inputs of a parser, to begin with."""
    samples = ROOT / "sample_videos"
    if parser == "people":
        track = {"person": "a", "first": 0, "stop": 9, "p": 0.9}
        seen = {"intervals": [[0, 9]], "times": [[0.0, 0.36]], "still": "people/1.jpg"}
        person = {"name": "a", "seconds": 0.4, "p": 0.9, **seen}
        whole = {"fps": 25.0, "shots": [{"first": 0, "stop": None}], "people": [person], "tracks": [track]}
        yield json.dumps({"format": "facetrack-people", "version": 1, **whole}).encode()
    elif parser == "arrays":
        yield (ROOT / "configs" / "mouth_prior.npz").read_bytes()
    elif parser == "live":
        yield b"YUV4MPEG2 W2 H2 F25:1 C420\nFRAME\n" + bytes(6)
        yield b"\xff\xd8\xff\xd9"
    elif parser == "init":
        yield from (path.read_bytes() for path in sorted(samples.glob("*.init.yaml")))
        yield b'{"frame": 0, "box": [1, 2, 3, 4]}'
    elif parser == "trajectory":
        yield b"".join((samples / "film.truth.csv").read_bytes().splitlines(keepends=True)[:4])
        part = {"part": "nose", "x": 1.0, "y": 2.0, "confidence": 0.5, "status": "tracked"}
        frame = {"frame": 0, "time_s": 0.0, "targets": [{"target": "face", "parts": [part]}]}
        clip = {"source": {"path": "a.mp4", "size": [64, 48], "fps": 25.0}, "recipe": {"name": "sir", "type": "x"}}
        start = {"init": {"from": "x", "frame": 0, "targets": {"face": {"box": [1, 2, 3, 4]}}}, "seed": 0}
        head = {"schema": "facetrack-trajectory", "version": 1, **clip, **start, "complete": True}
        yield json.dumps({**head, "frames": [frame]}).encode()
        yield "\n".join(map(json.dumps, ({"type": "header", **head}, {"type": "frame", **frame}))).encode()
    elif parser == "recipe":
        yield from (path.read_bytes() for path in sorted((ROOT / "configs").glob("*.yaml"))[::4])
    elif parser == "calibration":
        yield (ROOT / "configs" / "calibration" / "face.json").read_bytes()
    elif parser == "run":
        mark = f"1-{'0' * 16}"
        replace = {"files": ["a.csv", "people/1.jpg"], "gone": ["b"]}
        note = {"host": "h", "boot": "b", "process": 1, "mark": mark, "token": "t", "replace": replace}
        run = {"format": "facetrack-run", "version": 1, "frames": 3, "files": {}}
        yield json.dumps(note).encode() + b"\n\n" + json.dumps(run).encode()


def damaged(parser: str, count: int) -> Iterator[bytes]:
    """The seeds of a parser, damaged so many times, without guidance."""
    from tests.fuzz import hostile

    rng, whole = Random(parser), list(seeds(parser))
    for _ in range(count):
        one = rng.choice(whole)
        of_bytes = parser in ("arrays", "live") or rng.random() < 0.4
        yield hostile.data(rng, one) if of_bytes else hostile.text(rng, one.decode())


def main() -> None:
    import atheris

    name, seconds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else SECONDS
    with atheris.instrument_imports(include=["facetrack_cli"]):
        parse = parsers()[name]
    with tempfile.TemporaryDirectory(prefix="facetrack-seeds-") as folder:
        for number, data in enumerate(seeds(name)):
            Path(folder, str(number)).write_bytes(data)
        limits = [f"-max_total_time={seconds}", "-max_len=100000", "-timeout=30", "-rss_limit_mb=4096"]
        atheris.Setup([sys.argv[0], *limits, folder], lambda data: taken(parse, data))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
