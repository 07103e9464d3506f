"""What docs/pipelines.md gives to other programs that start jobs does what it says; skipped where they are missing."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.sway import make_clip
from tests.test_docs import ROOT, blocks

CLIPS = 3


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder with clips, in which `facetrack` is this one, and tracks few frames."""
    (tmp_path / "clips").mkdir()
    for i in range(CLIPS):
        make_clip(tmp_path / "clips" / f"{i}.mp4", 6)
    program = tmp_path / "bin" / "facetrack"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m facetrack_cli "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("FACETRACK_RUN_CONFIG", "factorized")
    monkeypatch.setenv("FACETRACK_RUN_SET", "filter.particles=20")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def block(kind, word):
    [found] = [text for text in blocks(ROOT / "docs" / "pipelines.md", kind) if word in text]
    return found


def done(folder):
    tables = sorted((folder / "results").glob("*/trajectory.csv"))
    return len(tables) == CLIPS and all(len(table.read_text().splitlines()) == 1 + 6 * 5 for table in tables)


@pytest.mark.skipif(shutil.which("parallel") is None, reason="GNU parallel is not installed")
def test_gnu_parallel(folder):
    said = subprocess.run(["sh", "-ec", block("sh", "| parallel")], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert done(folder) and re.search(rf"done +{CLIPS}\n", said.stdout)


@pytest.mark.skipif(shutil.which("snakemake") is None, reason="Snakemake is not installed")
def test_snakemake(folder):
    Path("Snakefile").write_text(block("python", "rule track"))
    words = ["snakemake", "--cores", "2"]
    said = subprocess.run(words, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert done(folder) and len(list(Path("shards").iterdir())) == 4


def test_a_slurm_array(folder):
    """Without SLURM: the script with the variables that SLURM sets."""
    script = block("sh", "SBATCH --array")
    (folder / "list.txt").write_text("clips/\n")
    script = script.replace("/shared/results", "results").replace("--config adaptive_robust ", "")
    script = script.replace("export NUMBA_CACHE_DIR", "unused")  # or all kernels would be compiled again
    for task in ("1", "2"):
        given = {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_COUNT": "2"}
        subprocess.run(["bash", "-ec", script], env={**os.environ, **given}, check=True)
    assert done(folder)
