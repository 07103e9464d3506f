"""Every command answers hostile inputs in one clear line, or takes them; `python -m tests.fuzz CASE` shows one."""

import os
import subprocess
import sys

import pytest

from tests.fuzz import guided
from tests.fuzz.cases import NAMED
from tests.support.samples import FOLDER

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="each case runs in a process that is forked")


def _tried(*words: object) -> str:
    command = [sys.executable, "-m", "tests.fuzz", *map(str, words)]
    done = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"{done.stdout}{done.stderr}"


def test_some_hostile_inputs_with_names_are_answered():
    assert _tried(*[*NAMED][::5]) == ""


@pytest.mark.parametrize("parser", guided.parsers())
def test_parsers_take_what_is_whole_and_refuse_the_rest(parser):
    """As the nightly fuzzers do, which are guided by coverage: guided.py."""
    parse = guided.parsers()[parser]
    assert sum(guided.taken(parse, seed) for seed in guided.seeds(parser)), "all are tried"
    for data in guided.damaged(parser, 50):
        guided.taken(parse, data)


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(0, 330, 30))
def test_more_hostile_inputs_are_answered(first):
    """With those that have names."""
    assert _tried("--first", first, 540) == ""
