"""Tables of text: whole on a narrow terminal, in any encoding, and for a reader who leaves."""

import os
import subprocess
import sys

import pytest

from facetrack_cli.evaluation import sheet
from facetrack_cli.evaluation.sheet import Sheet

GIVEN = Sheet(
    "a title",
    ("rank", "recipe", "mean\nerror, px ↓", "failed"),
    (("1", "sir", "12.34 ± 0.56", "0 of 10"),),
    ("A note. " * 9,),
    left=(1,),
)


@pytest.mark.parametrize("width", [20, 45, 100])
def test_a_table_loses_no_column_where_there_is_little_room(capsys, monkeypatch, width):
    monkeypatch.setattr(sheet, "WIDTH", width)
    GIVEN.show()
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split() == ["rank", "recipe", "error,", "px", "↓", "failed"]
    [row] = [line for line in lines if "sir" in line]
    assert row.split() == ["1", "sir", "12.34", "±", "0.56", "0", "of", "10"]
    notes = lines[lines.index(row) + 2 :]
    assert max(map(len, notes)) <= width and all(line == line.rstrip() for line in lines)


SHOW = (
    "from facetrack_cli.__main__ import main\n"
    "from facetrack_cli.cli.app import cli\n"
    "import click\n"
    "from tests.evaluation.test_sheet import GIVEN\n"
    "@click.command('table')\n"
    "def table(): [GIVEN.show() for _ in range(2000)]\n"
    "cli.get_command = lambda ctx, name: table\n"
    "import facetrack_cli.cli.app as c; c.COMMANDS['table'] = ''\n"
    "raise SystemExit(main(['table']))\n"
)


def test_a_reader_who_leaves_is_no_fault_of_ours():
    done = subprocess.run(
        ["bash", "-c", f'"{sys.executable}" -c "$SHOW" | head -1; exit ${{PIPESTATUS[0]}}'],
        env={**os.environ, "SHOW": SHOW},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (141, "a title\n", "")


@pytest.mark.one_in(2)
@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_letters_that_an_encoding_lacks(encoding):
    done = subprocess.run(
        [sys.executable, "-c", "from tests.evaluation.test_sheet import GIVEN; GIVEN.show()"],
        env={**os.environ, "PYTHONIOENCODING": encoding},
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    text = done.stdout.decode(encoding)
    assert "error, px ?" in text and len({len(line) for line in text.splitlines()[3:5]}) == 1


def test_names_that_are_no_text_are_printed_escaped():
    code = "import click\nfrom facetrack_cli import __main__ as m\nm._open_streams()\nclick.echo('caf\\udce9 \\u2193')"
    for encoding, expected in (("utf-8", "caf\\udce9 ↓\n"), ("cp1252", "caf\\udce9 \\u2193\n")):
        done = subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONIOENCODING": encoding}, capture_output=True
        )
        assert (done.returncode, done.stdout.decode(encoding)) == (0, expected), done.stderr
