"""What a tracker reports, on the page: who it is, scale, noise and error, eta as the recipe has it, and what is new."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures.diagnostics import adaptation, bounds_of, eta
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.report.test_plots import drawn, headings, panels, said

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")

NOISE = {"least": 0.5, "most": 2, "rate": 1}
HEADER = {"recipe": {"name": "adaptive", "motion": {"noise": NOISE}, "filter": {"particles": 100}}}
NEW = ["particles", "posterior", "scale", "noise η", "error ε", "entropy"]


def reported(people=3, frames=60, target="face", found=True, **columns):
    """What a tracker says of a target, of whom the second person is the likelier the longer one looks; without `found`
    as a CSV has it.
    """
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
    who = {name: known.pop(name) for name in ("identity", "identity_prob")}
    told = Diagnostics(tuple(KNOWN.values()), t, known, {"posterior": names})
    return SimpleNamespace(target=target, who=who, found=told if found is True else found)


def table(*those, header=HEADER, frames=60):
    t, sides = np.arange(frames), np.full(frames, 20.0)
    found = [
        one_part(one.target, "box", t, x=t, y=t, w=sides, h=sides, particles=90 + t % 3, **one.who) for one in those
    ]
    diagnostics = {one.target: one.found for one in those if one.found}
    return joined(found, path=Path("run/trajectory.json"), header=header, diagnostics=diagnostics)


def notes(figure, title):
    return " ".join(headings(panels(figure)[title])[1:])


def labels(axes):
    return [text.get_text() for text in axes.texts]


def test_a_panel_of_each_thing_that_is_reported_and_no_other():
    found = panels(plots.page_figure(table(reported())))
    assert [name for name in found if name in NEW] == NEW
    assert np.allclose(drawn(found["scale"])[0][:, 1], 1 + np.arange(60) / 100)
    assert np.allclose(drawn(found["error ε"])[0][:, 1], np.linspace(0.1, 0.9, 60))
    assert len({axes.get_xlim() for name, axes in found.items() if "over" not in name}) == 1
    curve, tall = found["noise η over error ε"].lines[0].get_xydata(), found["noise η over error ε"].patches
    assert np.allclose(curve[:, 1], eta(curve[:, 0], 0.5, 2, 1))
    assert len(tall) == 60 and tall[0].get_height() == 0 < max(bar.get_height() for bar in tall), "no error below 0.1"
    blank = np.full(60, np.nan)
    some = reported(0, identity_prob=blank, entropy=blank, noise=blank, error=blank)
    assert [name for name in panels(plots.page_figure(table(some))) if name in NEW] == ["particles", "scale"]
    bare = replace(table(reported()), diagnostics={}, identity=np.full(60, ""))
    bare = replace(bare, particles=np.full(60, 90.0), ess=np.full(60, 9.0))
    assert not {*NEW, "identity", "noise η over error ε"} & set(panels(plots.page_figure(bare)))


def test_posterior_has_a_line_each_and_their_names():
    figure = plots.page_figure(table(reported()))
    axes = panels(figure)["posterior"]
    lines = [line for line in drawn(axes) if len(line) > 2]
    assert len(lines) == 3 and labels(axes)[0] == "person 1"
    assert any(np.allclose(line[:, 1], np.minimum(1 / 3 + np.arange(60) / 20, 0.97)) for line in lines)
    assert notes(figure, "posterior") == "person 1 above 0.9 from frame 12"
    assert [line.get_ydata()[0] for line in axes.lines if len(set(line.get_ydata())) == 1] == [0.9]
    doubt = plots.page_figure(table(reported(2, frames=5), frames=5))
    assert "nobody above 0.9" in notes(doubt, "posterior")
    many = plots.page_figure(table(reported(60)))
    axes = panels(many)["posterior"]
    assert len([line for line in drawn(axes) if len(line) > 2]) == 60
    assert labels(axes) == ["person 1"] and "grey: 59 others" in notes(many, "posterior")
    five = plots.page_figure(table(reported(5)))
    plots.render(five, dpi=50)
    places = sorted(text.xy[1] for text in panels(five)["posterior"].texts)  # names stand apart
    assert len(places) == 5 and min(np.diff(places)) >= 0.12 - 1e-9 and places[0] > 0 and places[-1] < 1


def test_a_csv_has_the_probability_of_the_likeliest():
    one = reported(2, identity=np.where(np.arange(60) < 5, "ben", "anna"), found=None)
    found = panels(plots.page_figure(table(one, header={})))
    assert [name for name in found if name in [*NEW, "identity"]] == ["particles", "identity"]
    assert labels(found["identity"]) == ["anna", "ben"]


def test_true_scale_is_relative_to_the_start():
    made = table(reported())
    (ours,) = made.parts
    truth = replace(ours, w=30.0 * (1 + ours.x / 50), h=60.0 * (1 + ours.x / 50), status=np.full(60, "visible"))
    scale = panels(plots.page_figure(made, [Pair(ours, truth)]))["scale"]
    assert np.allclose(drawn(scale)[1][:, 1], 1 + np.arange(60) / 50)
    unknown = replace(truth, w=np.full(60, np.nan))
    assert len(drawn(panels(plots.page_figure(made, [Pair(ours, unknown)]))["scale"])) == 1


def test_eta_is_equation_13_of_a_recipe_with_adaptive_noise():
    assert eta(np.array([0.0, 1.0, 1e9]), 0.5, 2, 1) == pytest.approx([0.5, 0.5 + 1.5 * np.tanh(1), 2])
    assert "median 0.50; η there 1.19" in "; ".join(adaptation(table(reported())).notes)
    for noise in (None, 3, {}, {"least": 1, "most": 2}, {**NOISE, "most": "2"}, {**NOISE, "rate": 0},
                  {**NOISE, "least": True}, {**NOISE, "most": float("nan")}):  # fmt: skip
        none = table(reported(), header={"recipe": {"name": "x", "motion": {"noise": noise}}})
        assert bounds_of(none) is None and adaptation(none) is None
    for header in ({}, {"recipe": None}, {"recipe": {"motion": [1], "filter": 3}}):  # any header will do
        assert notes(plots.page_figure(table(reported(), header=header)), "particles") == "mean 91"


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("people", "frames", "width"), [(2, 1, 10), (1, 2, 4.6), (10, 5000, 10), (29, 30, 4.6)])
def test_page_of_any_shape_and_of_nonsense_numbers(people, frames, width):
    wild = np.r_[np.full(frames - 1, 1e-300), 1e300 if frames > 1 else 1.0]
    header = {"recipe": {"motion": {"noise": {"least": 1, "most": 1, "rate": 1e-9}}}}
    one = reported(people, frames, scale=wild, noise=wild, error=wild if people > 1 else np.zeros(frames))
    figure = plots.page_figure(table(one, frames=frames, header=header), width=width)
    assert plots.render(figure, "png", dpi=50).startswith(b"\x89PNG")


def test_names_are_cleaned():
    one = reported(2, target="_a\nb")
    one.found = replace(one.found, labels={"posterior": ("_x\n" + 50 * "y", "$z$")})
    figure = plots.page_figure(table(one, reported(target="b")))
    assert all("\n" not in text and len(text) <= 25 for text in labels(panels(figure)["posterior"]))
    assert said(figure)[0]


def test_what_a_tracker_declares_has_a_panel_with_its_meaning_and_unit():
    t = np.arange(60)
    focus = Diagnostic("focus", "sharpness of the window", "px", least=0)
    drift, votes = Diagnostic("drift", shape=(2,)), Diagnostic("votes", "of each camera", shape=None)
    values = {"focus": 5 + t / 10, "drift": np.stack([t, -t], axis=1), "votes": np.ones((60, 3)), "scale": 1 + t / 100}
    found = Diagnostics((votes, drift, KNOWN["scale"], focus), t, values, {"votes": ("a", "b", "c")})
    figure = plots.page_figure(table(reported(found=found, identity=np.full(60, ""))))
    shown = panels(figure)
    assert list(shown)[-4:] == ["scale", "votes", "drift", "focus"], "known ones first"
    assert np.allclose(drawn(shown["focus"])[0], np.stack([t, 5 + t / 10], axis=1))
    assert [notes(figure, name) for name in ("focus", "votes", "drift")] == [focus.meaning, "of each camera", ""]
    assert [headings(shown[name])[0] for name in ("focus", "drift")] == ["focus (px)", "drift"]
    assert shown["focus"].get_ylim()[0] == 0 and shown["drift"].get_ylim()[0] < -59
    assert [line[-1, 1] for line in drawn(shown["drift"])] == [59, -59] and len(drawn(shown["votes"])) == 3
