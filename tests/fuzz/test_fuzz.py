"""Every command answers hostile inputs in one clear line, or takes them; `python -m tests.fuzz CASE` shows one."""

import os
import subprocess
import sys
from functools import partial

import pytest

from tests.fuzz import guided
from tests.support.samples import FOLDER

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="each case runs in a process that is forked")


def _tried(count: int, first: int) -> str:
    command = [sys.executable, "-m", "tests.fuzz", "--first", str(first), str(count)]
    done = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"{done.stdout}{done.stderr}"


def test_hostile_inputs_are_answered():
    """Those with names."""
    assert _tried(0, 0) == ""


@pytest.mark.parametrize("parser", guided.parsers())
def test_parsers_take_what_is_whole_and_refuse_the_rest(parser):
    """As the nightly fuzzers do, which are guided by coverage: guided.py."""
    parse = guided.parsers()[parser]
    assert any(list(map(partial(guided.taken, parse), guided.seeds(parser))))
    for data in guided.damaged(parser, 150):
        guided.taken(parse, data)


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(0, 330, 30))
def test_more_hostile_inputs_are_answered(first):
    assert _tried(540, first) == ""
