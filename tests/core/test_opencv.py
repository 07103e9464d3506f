"""Another OpenCV than 4 or 5 is told in one line, before anything asks what it has not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from facetrack_cli.core.errors import UsageError, check_opencv


@pytest.mark.parametrize("version", ["6.0.0", "3.4.20", "of nothing"])
def test_another_version_is_refused_with_its_packages(version: str) -> None:
    with pytest.raises(UsageError) as caught:
        check_opencv(version)
    said = str(caught.value)
    assert f"cv2 is {version}" in said and "opencv-python-headless" in said and "\n" not in said
    assert "pip uninstall -y opencv" in said and "pip install --force-reinstall" in said and "<6" in said


@pytest.mark.parametrize("command", ["run clip.mp4", "report out", "people out", "fix out"])
def test_every_command_beside_opencv_6_ends_in_one_line(tmp_path: Path, command: str) -> None:
    (tmp_path / "cv2").mkdir()
    (tmp_path / "cv2" / "__init__.py").write_text('__version__ = "6.0.0"\n')
    (tmp_path / "clip.mp4").write_bytes(b"x")
    done = subprocess.run(
        [sys.executable, "-m", "facetrack_cli", *command.split()],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert (
        done.stderr.startswith("facetrack: error: OpenCV 4 or 5 is needed, and cv2 is 6.0.0")
        and done.stderr.count("\n") == 1
    )
