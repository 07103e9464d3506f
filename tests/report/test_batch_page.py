"""The page of a batch: each clip, the worst first, with a still and links to its files."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.run_folder.manifest import read_manifest
from tests.report.test_report import Reader
from tests.support.sway import SMALL, make_clip


@pytest.fixture
def batch(tmp_path, monkeypatch):
    """Of three clips: one is lost at its end, one is no video."""
    monkeypatch.chdir(tmp_path)
    Path("clips").mkdir()
    for name in ("a b", "c"):
        make_clip(Path(f"clips/{name}.mp4"), 6)
    Path("clips/d.mp4").write_bytes(b"no video")
    shutil.copy("clips/c.init.yaml", "clips/d.init.yaml")
    assert main(["run", "clips", "-o", "out", "-q", *SMALL]) == 5
    folder = Path("out/c-face")
    said = replace(read_manifest(folder), lost_frames={"face/nose": 5}, look=((1, 4),))
    import json

    (folder / "run.json").write_text(json.dumps(said.record()))
    return Path("out")


def test_the_page_shows_each_clip_the_worst_first(batch, capsys):
    assert main(["report", str(batch)]) == 0
    html = (batch / "batch.html").read_bytes()
    Reader(html)
    text = html.decode()
    names = re.findall(r'<th scope="row"[^>]*>([^<]*)<', text)
    assert names == ["d-face", "c-face", "a b-face"]
    assert "not a video" in text and "face nose is lost in 5, frames 1 to 4" in text
    assert text.count("<img ") == 2 and 'href="a%20b-face/annotated.mp4"' in text
    for link in re.findall(r'href="([^"]+)"', text):
        assert (batch / link.replace("%20", " ")).is_file()
    assert main(["report", str(batch)]) == 2, "it is not replaced"
    assert main(["report", str(batch), "-o", "elsewhere.html", "--title", "Mine", "-q"]) == 0
    assert 'href="out/c-face/annotated.mp4"' in Path("elsewhere.html").read_text(encoding="utf-8")


def test_what_a_batch_has_not(batch, capsys):
    assert main(["report", str(batch), "--truth", "x.csv"]) == 2
    assert "--truth and --clip are of one run" in capsys.readouterr().err
