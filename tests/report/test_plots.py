"""Figures: what of the data is in them, and that their bytes stay the same."""

import itertools
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.cli.commands.finished import FIGURES
from facetrack_cli.core.errors import InputError
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.report.figures import compare, page
from facetrack_cli.report.figures import style as plot_style
from facetrack_cli.report.figures.page import MAX_LINES, USUAL, lines_of
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.measures import MEASURES
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")


def track(frames=60, parts=3, targets=("face",), fps=25.0, **columns):
    """A trajectory with everything known; `columns` replace what a column holds, None takes it out."""
    rng = np.random.default_rng(3)
    t = np.arange(frames)
    found = []
    for target, k in itertools.product(targets, range(parts)):
        known = {
            "time_s": t / fps,
            "x": 100 + 10 * k + np.sin(t / 9),
            "y": 50 + 10 * k + np.cos(t / 9),
            "w": np.full(frames, 12.0),
            "h": np.full(frames, 14.0),
            "confidence": rng.uniform(0.6, 1, frames),
            "status": np.where(t == 0, "init", "tracked"),
            "std_x": np.full(frames, 1.0),
            "std_y": np.full(frames, 2.0),
            "particles": np.full(frames, 80),
            "ess": rng.uniform(5, 50, frames),
        } | columns
        found.append(one_part(target, f"part_{k}", t, **{key: v for key, v in known.items() if v is not None}))
    return joined(found, path=Path("runs/clip-sir/trajectory.csv"))


def pairs_of(table, off=(3.0, 4.0), status="visible"):
    truths = [replace(s, x=s.x - off[0], y=s.y - off[1], status=np.full(len(s), status)) for s in table.parts]
    return [Pair(s, truth) for s, truth in zip(table.parts, truths, strict=True)]


def headings(axes):
    """The title and the note above a panel; [] without."""
    return list(filter(None, (axes.get_title("left"), axes.get_title("right"))))


def panels(figure):
    """Axes by the first word of their headings."""
    return {words[0].split(" (")[0]: axes for axes in figure.axes if (words := headings(axes))}


def said(figure):
    """The title, what stands below it, and the labels of the legend."""
    legend = figure.axes[0].get_legend()
    texts = figure.get_suptitle(), legend.get_title().get_text()
    return texts, labels(figure.axes[0])


def drawn(axes):
    """(x, y) of every line with more than one point."""
    return [line.get_xydata() for line in axes.lines if len(line.get_xdata()) > 1]


def test_lines_break_where_frames_are_missing_and_single_ones_are_seen():
    frame = np.r_[0:40, 80:120]
    x, y = plot_style.broken(frame, np.ones(80))
    assert np.flatnonzero(np.isnan(x)).tolist() == np.flatnonzero(np.isnan(y)).tolist() == [40]
    assert not np.isnan(plot_style.broken(np.arange(0, 400, 5), np.ones(80))).any(), "every fifth frame is no gap"
    with plot_style.style():
        axes = plot_style.new_figure(4, 3).subplots()
        plot_style.line(axes, np.arange(6), np.array([1, np.nan, 2, 3, np.nan, 4]), color="k")
    assert axes.lines[1].get_xdata().tolist() == [0, 5], "a mark for each that has no neighbour"
    frame = np.arange(10)
    mask = np.isin(frame, [0, 1, 2, 5, 9])
    assert plot_style.frame_spans(frame, mask) == [(-0.5, 2.5), (4.5, 5.5), (8.5, 9.5)]
    assert plot_style.frame_spans(frame, mask, 3.0) == [(-0.5, 10.5)], "near ones join"
    assert plot_style.frame_spans(np.arange(10_000), np.arange(10_000) == 50, 20) == [(40, 60)], "one frame is seen"
    assert plot_style.frame_spans(frame * 10, mask)[0] == (-5, 25)


def test_a_long_band_has_few_corners_and_holds_every_value():
    low = np.random.default_rng(0).uniform(-1, 1, 50_000)
    low[7_000:9_000] = np.nan
    with plot_style.style():
        axes = plot_style.new_figure(4, 3).subplots()
        plot_style.band(axes, np.arange(50_000), low, low + 1, "#000000", 0.5)
    areas = axes.collections[0].get_paths()
    corners = np.concatenate([area.vertices for area in areas])[:, 1]
    assert len(areas) == 2, "nothing is known between"
    assert len(corners) < 2500 and (corners.min(), corners.max()) == (np.nanmin(low), np.nanmax(low) + 1)


@given(st.lists(st.lists(st.one_of(st.floats(-9, 9), st.just(np.nan)), min_size=4, max_size=4), min_size=1, max_size=9))
def test_quantiles_are_those_of_numpy(rows):
    values = np.array(rows)
    known = np.isfinite(values).any(axis=0)
    for share, found in zip((0, 0.1, 0.5, 0.9, 1), plot_style.quantiles(values, (0, 0.1, 0.5, 0.9, 1)), strict=True):
        np.testing.assert_allclose(found[known], np.nanquantile(values[:, known], share, axis=0), atol=1e-12)
        assert np.isnan(found[~known]).all()


def test_times_stand_above_the_frames_they_are_shown_at():
    t = np.arange(101.0)
    time_s = np.where(t <= 50, t / 25, 2 + (t - 50) / 10)  # the rate changes
    with plot_style.style():
        axes = plot_style.new_figure(4, 3).subplots()
        plot_style.time_axis(axes, track(time_s=None), 5)
        assert not axes.child_axes, "no time is known"
        plot_style.frame_axis(axes, np.arange(101))
        plot_style.time_axis(axes, track(101, time_s=time_s), 8)
        (above,) = axes.child_axes
        axes.figure.draw_without_rendering()
        labels = dict(zip(above.get_xticks(), (label.get_text() for label in above.get_xticklabels()), strict=True))
    assert (labels[20], labels[60]) == ("0:00.80", "0:03.00")


def test_legends_stand_between_the_first_panel_and_the_title():
    table = track(4, MAX_LINES)
    figure = page.page_figure(table, pairs_of(table, status="hidden"))
    plot_style.render(figure, dpi=50)
    box, panel = (part.get_window_extent() for part in (figure.axes[0].get_legend(), figure.axes[0]))
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
    assert panel.y1 + 8 < box.y0 < box.y1 < figure.bbox.y1 - 8


ALL = ["x", "y", "size", "confidence", "status", "effective sample size", "spread"]


def test_measures_have_a_panel_each_with_their_spread_as_a_band():
    table = moving_face(60, noise=0.5, open=np.linspace(0, 0.3, 60))
    found = panels(page.page_figure(table))
    names = [one.name.replace("_", " ") if one.of else f"pose: {one.name}" for one in MEASURES if one.name in USUAL]
    assert [name for name in found if name in names] == names
    axes, one = found["mouth opening"], table.measures["face"]["mouth_opening"]
    np.testing.assert_allclose(drawn(axes)[0], np.stack([one.frame, one.value], axis=1))
    low, high = (one.value + sign * one.std for sign in (-1, 1))
    corners = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert corners.min() == pytest.approx(low.min()) and corners.max() == pytest.approx(high.max())


BARE = dict.fromkeys(("particles", "ess", "std_x", "confidence"))


@pytest.mark.parametrize(
    ("columns", "there"),
    [
        ({}, ALL),
        ({**BARE, "std_y": None}, ["x", "y", "size", "status"]),
        ({**BARE, "status": None, "w": None, "angle": np.arange(60.0)}, ["x", "y", "angle"]),
        (dict.fromkeys(("x", "y", "w", "status", *BARE)), []),
        ({"ess": None}, [name if name != "effective sample size" else "particles" for name in ALL]),
    ],
)
def test_page_has_a_panel_of_what_is_known_and_no_other(columns, there):
    table = track(**columns)
    if not there:
        with pytest.raises(InputError, match=r"trajectory\.csv: has no number"):
            page.page_figure(table)
        return
    assert list(panels(page.page_figure(table))) == there
    assert list(panels(page.page_figure(table, pairs_of(table)))) == [*there, "error"]


def test_page_draws_the_values():
    table = track()
    found = panels(page.page_figure(table, pairs_of(table)))
    x = drawn(found["x"])
    assert np.allclose(x[1], np.stack([table.parts[1].frame, table.parts[1].x], axis=1))
    assert np.allclose(x[3][:, 1], table.parts[0].x - 3), "truth comes after ours"
    assert np.allclose(drawn(found["size"])[0][:, 1], np.sqrt(12 * 14))
    assert np.allclose(drawn(found["spread"])[0][:, 1], np.sqrt(5))
    assert np.allclose(drawn(found["error"])[0][:, 1], 5)
    assert found["y"].yaxis_inverted() and not found["x"].yaxis_inverted()
    assert found["confidence"].get_ylim() == pytest.approx((-0.03, 1.06))
    assert len({tuple(axes.get_xlim()) for axes in found.values()}) == 1
    table = track(parts=1).renamed("face", "box")
    found = panels(page.page_figure(table, pairs_of(table, off=(6.0, 0.0))))
    assert list(found)[-2:] == ["error", "overlap"]
    assert np.allclose(drawn(found["overlap"])[0][:, 1], 6 / 18)
    assert "error" not in panels(page.page_figure(table, pairs_of(table, status="absent")))


def test_page_shades_what_is_lost_and_hidden():
    status = np.where(np.isin(np.arange(60), range(20, 30)), "lost", "tracked")
    table = track(status=status)
    tracked = replace(table.parts[2], status=np.where(np.arange(60) < 25, "tracked", status))
    table = joined([*table.parts[:2], tracked])
    pairs = pairs_of(table)
    pairs[0] = pairs[0]._replace(truth=replace(pairs[0].truth, status=np.where(np.arange(60) < 5, "hidden", "visible")))
    figure = page.page_figure(table, pairs)
    found = panels(figure)
    spans = [(p.get_x(), p.get_x() + p.get_width()) for p in found["confidence"].patches]
    assert spans == [(19.5, 29.5), (24.5, 29.5)], "pale where any is lost, darker where all are"
    assert [(p.get_x(), p.get_width()) for p in found["error"].patches] == [(-0.5, 5.0)]
    texts, labels = said(figure)
    assert labels == ["part 0", "part 1", "part 2", "ground truth", "hidden", "lost"]
    assert "lost in 13.9 % of rows" in texts[1] and "median error 5.00 px" in texts[1]


def test_page_names_itself():
    assert said(page.page_figure(track()))[0][0] == "clip-sir"
    header = {"source": {"path": "a/b.mp4"}, "recipe": {"name": "sir"}, "seed": 4, "complete": False}
    named = replace(track(), header=header)
    texts, _ = said(page.page_figure(named))
    assert texts[0] == "b.mp4, sir"
    assert texts[1].split("   ·   ") == ["60 frames", "never called lost", "the run was cut short"]
    assert said(page.page_figure(named, title="$x_1$\nmine"))[0][0] == "$x_1$?mine"


WILD = np.r_[np.full(59, -1e6), 1e6]
GONE = {"status": np.full(60, "lost"), "confidence": np.zeros(60), "x": WILD, "w": WILD, "ess": WILD, "std_x": WILD}


@pytest.mark.parametrize(
    ("frames", "parts", "targets", "columns"),
    [
        (1, 5, ("face",), {}),
        (9, 3, ("_a\nb", "b_", "漢"), {}),
        (60, 3, ("face",), GONE),
        pytest.param(40, 68, ("face",), {}, marks=pytest.mark.nightly),
    ],
)
def test_page_of_any_shape(frames, parts, targets, columns):
    table = track(frames, parts, targets, **columns)
    figure = page.page_figure(table, pairs_of(table, status="hidden"), width=4.6)
    assert plot_style.render(figure, "png", dpi=50).startswith(b"\x89PNG") and len(panels(figure)) >= 7
    assert not any("\n" in label for label in said(figure)[1])


def test_lines_of_one_target_differ_by_colour_and_of_several_by_their_target():
    one = lines_of(track(parts=5), [])
    assert len({str(plot_style.line_style(i)) for i in range(12)}) == 12
    assert len({line.look["color"] for line in one}) == 5 and one[0].name == "part 0"
    several = lines_of(track(parts=2, targets=("a", "b")), [])
    assert [line.look["color"] for line in several] == [plot_style.COLOURS[i] for i in (0, 0, 1, 1)]
    assert len({str(line.look) for line in several}) == 4
    assert [line.name for line in lines_of(track(parts=1, targets=("head", "left_hand")), [])] == ["head", "left hand"]
    assert {line.look["linewidth"] for line in lines_of(track(parts=MAX_LINES + 1), [])} == {0.6}


def test_many_parts_are_drawn_as_bands():
    table = track(40, 20)
    figure = page.page_figure(table, pairs_of(table))
    found = panels(figure)
    assert len(drawn(found["x"])) == 20
    assert len(found["confidence"].collections) == 2
    values = np.stack([s.confidence for s in table.parts])
    assert np.allclose(drawn(found["confidence"])[0][:, 1], np.median(values, axis=0))
    assert said(figure)[1] == ["face: 20 parts, their median, middle 80 % and range"]
    assert "status" not in found, "no part is lost"
    gone = (table.which == 3) | ((table.which == 7) & (table.frame < 9)) | (table.which == 5) & (table.frame < 20)
    figure = page.page_figure(replace(table, status=np.where(gone, "lost", table.status)))
    named = [label.get_text() for label in panels(figure)["status"].get_yticklabels()]
    assert named == [lines_of(table, [])[k].name for k in (3, 5, 7)], "the parts that are seen least"
    crowd = page.page_figure(track(9, 1, [f"person{n}" for n in range(20)]))
    assert said(crowd)[1][:2] == ["person0", "person1"]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].texts]


def curves(of, measure="AUC", mark=None):
    return compare.curves_figure(of, "Success", ("threshold", "share"), measure, mark)


def test_success_ranks_by_area_and_keeps_a_recipe_its_colour():
    at = np.linspace(0, 1, 21)
    figure = curves({"poor": (at, np.tile(1 - at, (3, 1))), "good": (at, np.stack([np.ones(21), np.full(21, 0.9)]))})
    assert legend(figure) == ["0.950  good", "0.500  poor"]
    axes, handles = figure.axes[0], figure.legends[0].legend_handles
    assert np.allclose(drawn(axes)[1][:, 1], 0.95)
    assert [line.get_color() for line in axes.lines] == [handle.get_color() for handle in handles][::-1]
    assert len(axes.collections) == 2, "bands over seeds"
    assert not curves({"one": (at, at[None])}).axes[0].collections
    assert (axes.get_xlabel(), figure.legends[0].get_title().get_text()) == ("threshold", "AUC")
    assert plot_style.render(figure).startswith(b"\x89PNG")
    marked = curves({"_a": (50 * at, np.tile(at, (2, 1)))}, "at 20 px", 20)  # read off there
    assert legend(marked) == ["0.400   _a"] and marked.legends[0].get_title().get_text() == "at 20 px"
    assert any(np.allclose(line.get_xdata(), 20) for line in marked.axes[0].lines)


def test_error_over_time_has_the_median_and_what_is_hidden():
    errors = np.array([[1.0], [2], [9]]) * np.ones(20)
    errors[:, 3] = np.nan
    frames = np.arange(100, 120)
    figure = compare.error_over_time_figure(frames, {"a": errors}, np.isin(frames, range(105, 110)))
    (axes,) = figure.axes
    line = drawn(axes)[0]
    assert np.nanmax(line[:, 1]) == np.nanmin(line[:, 1]) == 2
    assert np.isnan(line[:, 1]).sum() == 1
    (shade,) = axes.patches
    assert (shade.get_x(), shade.get_x() + shade.get_width()) == (104.5, 109.5)
    assert plot_style.render(figure, "svg").startswith(b"<?xml")


@pytest.mark.one_in(2)
@pytest.mark.parametrize("form", FIGURES)
def test_same_numbers_give_the_same_bytes_whatever_the_user_has_set(form):
    import matplotlib

    table = track(parts=1, **BARE, w=None)
    first = plot_style.render(page.page_figure(table), form)
    with matplotlib.rc_context(
        {"lines.linewidth": 9, "font.size": 20, "svg.hashsalt": "other", "figure.dpi": 30, "xtick.direction": "in"}
    ):
        assert plot_style.render(page.page_figure(table), form) == first
        assert matplotlib.rcParams["lines.linewidth"] == 9, "the user's settings come back"
    assert not re.search(rb"(?i)date>|CreationDate|20[2-9]\d-\d\d", first)


NEW = ["particles", "identity", "entropy", "scale", "noise", "error"]


def reported(people=3, found=True, **columns):
    """What a tracker says of a target in 60 frames, of whom the second person is the likelier the longer one looks;
    without `found` as a CSV has it.
    """
    t, names = np.arange(60), tuple(f"person {n}" for n in range(people))
    sure = np.minimum(1 / people + t / 20, 0.97)
    posterior = np.repeat(((1 - sure) / (people - 1))[:, None], people, axis=1)
    posterior[:, 1] = sure
    known = {
        "identity": np.full(60, names[1]),
        "identity_prob": posterior.max(axis=1),
        "posterior": posterior,
        "entropy": np.linspace(1, 0, 60),
        "scale": 1 + t / 100,
        "noise": np.full(60, 1.5),
        "error": np.linspace(0.1, 0.9, 60),
        "affine": np.full((60, 6), np.nan),
    } | columns
    who = {name: known.pop(name) for name in ("identity", "identity_prob")}
    told = Diagnostics(tuple(KNOWN.values()), t, known, {"posterior": names})
    return SimpleNamespace(who=who, found=told if found is True else found)


def table(one):
    t, sides = np.arange(60), np.full(60, 20.0)
    box = one_part("face", "box", t, x=t, y=t, w=sides, h=sides, particles=90 + t % 3, **one.who)
    diagnostics = {"face": one.found} if one.found else {}
    return joined([box], path=Path("run/trajectory.json"), diagnostics=diagnostics)


def notes(figure, title):
    return " ".join(headings(panels(figure)[title])[1:])


def labels(axes):
    return [text.get_text() for text in axes.get_legend().texts]


def test_a_panel_of_each_thing_that_is_reported_and_no_other():
    found = panels(page.page_figure(table(reported())))
    assert [name for name in found if name in NEW] == NEW
    assert np.allclose(drawn(found["scale"])[0][:, 1], 1 + np.arange(60) / 100)
    assert np.allclose(drawn(found["error"])[0][:, 1], np.linspace(0.1, 0.9, 60))
    assert len({axes.get_xlim() for axes in found.values()}) == 1
    blank = np.full(60, np.nan)
    some = panels(page.page_figure(table(reported(entropy=blank, noise=blank))))
    assert [name for name in some if name in NEW] == ["particles", "identity", "scale", "error"]
    bare = replace(table(reported()), diagnostics={}, identity=np.full(60, ""))
    bare = replace(bare, particles=np.full(60, 90.0), ess=np.full(60, 9.0))
    assert not {*NEW} & set(panels(page.page_figure(bare)))


def test_posterior_has_a_line_each_and_their_names():
    figure = page.page_figure(table(reported()))
    axes = panels(figure)["identity"]
    lines = [line for line in drawn(axes) if len(line) > 2]
    assert len(lines) == 3 and labels(axes)[0] == "person 1"
    assert any(np.allclose(line[:, 1], np.minimum(1 / 3 + np.arange(60) / 20, 0.97)) for line in lines)
    guides = [line for line in axes.lines if len(line.get_xdata()) == 2]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in guides] == [(0, 1, 0.9, 0.9), (12, 12, 0, 1)]
    csv = reported(2, identity=np.where(np.arange(60) < 5, "ben", "anna"), found=None)  # has that of the likeliest
    found = panels(page.page_figure(table(csv)))
    assert [name for name in found if name in NEW] == ["particles", "identity"]
    assert labels(found["identity"]) == ["anna", "ben"]
    axes = panels(page.page_figure(table(reported(60))))["identity"]
    assert len([line for line in drawn(axes) if len(line) > 2]) == 60
    assert labels(axes)[0] == "person 1" and len(labels(axes)) == 5


def test_what_a_tracker_declares_has_a_panel_with_its_meaning_and_unit():
    t = np.arange(60)
    focus = Diagnostic("focus", "sharpness of the window", "px", least=0)
    drift, votes = Diagnostic("drift", shape=(2,)), Diagnostic("votes", "of each camera", shape=None, least=0, most=1)
    values = {"focus": 5 + t / 10, "drift": np.stack([t, -t], axis=1), "votes": np.ones((60, 3)), "scale": 1 + t / 100}
    found = Diagnostics((votes, drift, KNOWN["scale"], focus), t, values, {"votes": ("a", "b", "c")})
    figure = page.page_figure(table(reported(found=found, identity=np.full(60, ""))))
    shown = panels(figure)
    assert list(shown)[-4:] == ["votes", "drift", "scale", "focus"]
    assert np.allclose(drawn(shown["focus"])[0], np.stack([t, 5 + t / 10], axis=1))
    assert [notes(figure, name) for name in ("focus", "votes", "drift")] == [focus.meaning, "of each camera", ""]
    assert [headings(shown[name])[0] for name in ("focus", "drift")] == ["focus (px)", "drift"]
    assert [line[-1, 1] for line in drawn(shown["drift"])] == [59, -59] and len(drawn(shown["votes"])) == 3
    assert shown["votes"].get_ylim() == (-0.03, 1.06), "shares near 1 are near 1"
