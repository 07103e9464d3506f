"""Workflows and the container take what was looked at, and no more rights than they need."""

import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from tests.fuzz import guided

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))

pytestmark = pytest.mark.skipif(not WORKFLOWS, reason="a source distribution has no workflows")


def read(path):
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_takes_what_is_pinned(path):
    text = path.read_text(encoding="utf-8")
    uses = re.findall(r"uses: (.+)", text)
    assert uses and all(re.fullmatch(r"[\w.-]+(/[\w.-]+)+@[0-9a-f]{40} # v\d+\.\d+\.\d+", one) for one in uses)
    for words in re.findall(r"pip install ([^\n&]+)", text):
        assert words.startswith(("--require-hashes ", "--no-deps ")), words


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_has_few_rights_and_an_end(path):
    whole = read(path)
    assert whole["permissions"] == {"contents": "read"}
    for name, job in whole["jobs"].items():
        assert job["timeout-minutes"] <= 350, name
        for step in job["steps"]:
            if "checkout" in step.get("uses", ""):
                assert step["with"]["persist-credentials"] is False, name


def test_the_nightly_workflow_runs_each_fuzzer_every_night():
    whole = read(ROOT / ".github" / "workflows" / "nightly.yml")
    jobs = whole["jobs"]
    assert whole["on"]["schedule"] and jobs["fuzz"]["strategy"]["matrix"]["parser"] == [*guided.parsers()]
    assert any("-m ''" in step.get("run", "") for step in jobs["tests"]["steps"])


def test_the_container_is_of_one_image_and_has_a_user():
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    assert all(re.search(r"@sha256:[0-9a-f]{64}$", line) for line in lines if line.startswith("FROM "))
    [user] = [line for line in lines if line.startswith("USER ")]
    assert int(user.split()[1]) > 0
