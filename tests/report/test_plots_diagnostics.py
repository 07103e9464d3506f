"""What a tracker reports, on the page: who it is, scale, noise and error, eta as the recipe has it, and what is new."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures.diagnostics import adaptation, bounds_of, eta
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import Trajectory, joined, one_part
from tests.report.test_plots import drawn, panels, said

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")

HEADER = {
    "recipe": {
        "name": "adaptive",
        "motion": {"noise": {"least": 0.5, "most": 2, "rate": 1}},
        "filter": {"particles": 100},
    }
}
NEW = ["particles", "posterior", "scale", "noise η", "error ε", "entropy"]


class Reported(NamedTuple):
    """What a tracker says of a target, beside its box; without `found` as a CSV has it."""

    target: str
    identity: Any
    identity_prob: Any
    found: Diagnostics | None


def reported(people: int = 3, frames: int = 60, target: str = "face", **columns: Any) -> Reported:
    """Of whom the second is the likelier the longer one looks."""
    t = np.arange(frames)
    names = tuple(f"person {n}" for n in range(people))
    posterior = np.full((frames, people), np.nan)
    if people:
        sure = np.minimum(1 / people + t / 20, 0.97)
        posterior[:] = ((1 - sure) / max(people - 1, 1))[:, None]
        posterior[:, min(1, people - 1)] = sure
    known = {
        "identity": np.full(frames, names[min(1, people - 1)] if names else ""),
        "identity_prob": posterior.max(axis=1, initial=0.0),
        "posterior": posterior,
        "entropy": np.linspace(1, 0, frames),
        "scale": 1 + t / 100,
        "noise": np.full(frames, 1.5),
        "error": np.linspace(0.1, 0.9, frames),
        "affine": np.full((frames, 6), np.nan),
    } | columns
    who, prob = known.pop("identity"), known.pop("identity_prob")
    return Reported(target, who, prob, Diagnostics(tuple(KNOWN.values()), t, known, {"posterior": names}))


def table(*those: Reported, header: dict[str, Any] | None = None, frames: int = 60) -> Trajectory:
    t = np.arange(frames)
    sides = np.full(frames, 20.0)
    found = [
        one_part(one.target, "box", t, x=t, y=t, w=sides, h=sides, particles=90 + t % 3, identity=one.identity,
                 identity_prob=one.identity_prob)
        for one in those
    ]  # fmt: skip
    return joined(
        found,
        path=Path("run/trajectory.json"),
        header=HEADER if header is None else header,
        diagnostics={one.target: one.found for one in those if one.found is not None},
    )


def notes(figure: Any, title: str) -> str:
    axes = panels(figure)[title]
    (box,) = [a for a in axes.artists if hasattr(a, "get_child")]
    return " ".join(area.get_text() for area in box.get_child().get_children()[1:])


def labels(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_a_panel_of_each_thing_that_is_reported() -> None:
    found = panels(plots.page_figure(table(reported())))
    assert [name for name in found if name in NEW] == NEW
    assert "noise η over error ε" in found
    assert np.allclose(drawn(found["scale"])[0][:, 1], 1 + np.arange(60) / 100)
    assert np.allclose(drawn(found["error ε"])[0][:, 1], np.linspace(0.1, 0.9, 60))
    assert len({axes.get_xlim() for name, axes in found.items() if "over" not in name}) == 1


def test_no_panel_of_what_is_not_reported() -> None:
    blank = np.full(60, np.nan)
    some = reported(0, identity_prob=blank, entropy=blank, noise=blank, error=blank)
    assert [name for name in panels(plots.page_figure(table(some))) if name in NEW] == ["particles", "scale"]
    bare = replace(table(reported()), diagnostics={}, identity=np.full(60, ""))
    assert not {*NEW[1:], "identity", "noise η over error ε"} & set(panels(plots.page_figure(bare)))
    steady = replace(table(reported()), particles=np.full(60, 90.0), ess=np.full(60, 9.0))
    assert "particles" not in panels(plots.page_figure(steady)), "a fixed number stands behind the sample size"


def test_posterior_has_a_line_each_and_their_names() -> None:
    figure = plots.page_figure(table(reported()))
    axes = panels(figure)["posterior"]
    lines = [line for line in drawn(axes) if len(line) > 2]
    assert len(lines) == 3 and labels(axes)[0] == "person 1"
    assert any(np.allclose(line[:, 1], np.minimum(1 / 3 + np.arange(60) / 20, 0.97)) for line in lines)
    assert notes(figure, "posterior") == "person 1 above 0.9 from frame 12"
    assert [line.get_ydata()[0] for line in axes.lines if len(set(line.get_ydata())) == 1] == [0.9]
    doubt = reported(2, frames=5)
    assert "nobody above 0.9" in notes(plots.page_figure(table(doubt, frames=5)), "posterior")


def test_of_many_people_the_leading_ones_are_named() -> None:
    figure = plots.page_figure(table(reported(60)))
    axes = panels(figure)["posterior"]
    assert len([line for line in drawn(axes) if len(line) > 2]) == 60
    assert labels(axes) == ["person 1"] and "grey: 59 others" in notes(figure, "posterior")


def test_labels_stand_apart() -> None:
    figure = plots.page_figure(table(reported(5)))
    plots.render(figure, dpi=50)
    axes = panels(figure)["posterior"]
    places = sorted(text.xy[1] for text in axes.texts)
    assert len(places) == 5 and min(np.diff(places)) >= 0.12 - 1e-9 and places[0] > 0 and places[-1] < 1


def test_a_csv_has_the_probability_of_the_likeliest() -> None:
    who = np.where(np.arange(60) < 5, "ben", "anna")
    one = reported(2)._replace(identity=who, found=None)
    found = panels(plots.page_figure(table(one, header={})))
    assert [name for name in found if name in [*NEW, "identity"]] == ["particles", "identity"]
    assert labels(found["identity"]) == ["anna", "ben"]


def test_true_scale_is_relative_to_the_start() -> None:
    made = table(reported())
    (ours,) = made.parts
    truth = replace(ours, w=30.0 * (1 + ours.x / 50), h=60.0 * (1 + ours.x / 50), status=np.full(60, "visible"))
    scale = panels(plots.page_figure(made, [Pair(ours, truth)]))["scale"]
    assert np.allclose(drawn(scale)[1][:, 1], 1 + np.arange(60) / 50)
    unknown = replace(truth, w=np.full(60, np.nan))
    assert len(drawn(panels(plots.page_figure(made, [Pair(ours, unknown)]))["scale"])) == 1


def test_eta_is_equation_13() -> None:
    assert eta(np.array([0.0, 1.0, 1e9]), 0.5, 2, 1) == pytest.approx([0.5, 0.5 + 1.5 * np.tanh(1), 2])
    panel = adaptation(table(reported()))
    assert panel is not None and "median 0.50; η there 1.19" in "; ".join(panel.notes)
    axes = panels(plots.page_figure(table(reported())))["noise η over error ε"]
    curve = axes.lines[0].get_xydata()
    assert np.allclose(curve[:, 1], eta(curve[:, 0], 0.5, 2, 1))
    tall = [bar.get_height() for bar in axes.patches]
    assert len(tall) == 60 and tall[0] == 0 and max(tall) > 0, "no error is below 0.1"


FULL = {"least": 1, "most": 2, "rate": 1}


@pytest.mark.parametrize(
    "noise",
    [
        None,
        3,
        {},
        {"least": 1, "most": 2},
        *({**FULL, **one} for one in ({"most": "2"}, {"rate": 0}, {"least": True}, {"most": float("nan")})),
    ],
)
def test_a_recipe_without_adaptive_noise_has_no_eta(noise: Any) -> None:
    header = {"recipe": {"name": "x", "motion": {"noise": noise}}}
    assert bounds_of(table(reported(), header=header)) is None
    assert "noise η over error ε" not in panels(plots.page_figure(table(reported(), header=header)))


@pytest.mark.parametrize("header", [{}, {"recipe": None}, {"recipe": {"motion": [1], "filter": 3}}])
def test_any_header_will_do(header: dict[str, Any]) -> None:
    assert notes(plots.page_figure(table(reported(), header=header)), "particles") == "mean 91"


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("people", "frames", "width"), [(2, 1, 10), (1, 2, 4.6), (10, 5000, 10), (29, 30, 4.6)])
def test_page_of_any_shape(people: int, frames: int, width: float) -> None:
    figure = plots.page_figure(table(reported(people, frames), frames=frames), width=width)
    assert plots.render(figure, "png", dpi=50).startswith(b"\x89PNG")


def test_nonsense_numbers_are_drawn() -> None:
    wild = np.r_[np.full(59, 1e-300), 1e300]
    assert plots.render(plots.page_figure(table(reported(scale=wild, noise=wild, error=wild))), dpi=50)
    header = {"recipe": {"motion": {"noise": {"least": 1, "most": 1, "rate": 1e-9}}}}
    assert plots.render(plots.page_figure(table(reported(error=np.zeros(60)), header=header)), dpi=50)


def test_names_are_cleaned() -> None:
    one = reported(2, target="_a\nb")
    assert one.found is not None
    found = replace(one.found, labels={"posterior": ("_x\n" + 50 * "y", "$z$")})
    figure = plots.page_figure(table(one._replace(found=found), reported(target="b")))
    assert all("\n" not in text and len(text) <= 25 for text in labels(panels(figure)["posterior"]))
    assert said(figure)[0]


def test_what_a_tracker_declares_has_a_panel_with_its_meaning_and_unit() -> None:
    t = np.arange(60)
    focus = Diagnostic("focus", "sharpness of the window", "px", least=0)
    drift = Diagnostic("drift", shape=(2,))
    votes = Diagnostic("votes", "of each camera", shape=None)
    values = {"focus": 5 + t / 10, "drift": np.stack([t, -t], axis=1), "votes": np.ones((60, 3)), "scale": 1 + t / 100}
    declared = (votes, drift, KNOWN["scale"], focus)
    found = Diagnostics(declared, t, values, {"votes": ("a", "b", "c")})
    figure = plots.page_figure(table(reported()._replace(found=found, identity=np.full(60, ""))))
    shown = panels(figure)
    assert list(shown)[-4:] == ["scale", "votes", "drift", "focus"], "known ones first"
    assert np.allclose(drawn(shown["focus"])[0], np.stack([t, 5 + t / 10], axis=1))
    assert notes(figure, "focus") == "sharpness of the window" and shown["focus"].get_ylim()[0] == 0
    texts = [text for axes in figure.axes for text in heading_of(axes)]
    assert "focus (px)" in texts and "drift" in texts
    assert [line[-1, 1] for line in drawn(shown["drift"])] == [59, -59] and shown["drift"].get_ylim()[0] < -59
    assert len(drawn(shown["votes"])) == 3 and notes(figure, "votes") == "of each camera"
    assert notes(figure, "drift") == ""


def heading_of(axes: Any) -> list[str]:
    boxes = [a for a in axes.artists if hasattr(a, "get_child")]
    return [boxes[0].get_child().get_children()[0].get_text()] if boxes else []
