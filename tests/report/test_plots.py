"""Figures: what of the data is in them, and that their bytes stay the same."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures import style as plot_style
from facetrack_cli.report.figures.page import USUAL
from facetrack_cli.report.figures.style import MAX_LINES, columns_for, lines_of, numbers
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
    boxes = [a for a in axes.artists if hasattr(a, "get_child")]
    return [area.get_text() for area in boxes[0].get_child().get_children()] if boxes else []


def panels(figure):
    """Axes by the first word of their headings."""
    return {words[0].split(" (")[0]: axes for axes in figure.axes if (words := headings(axes))}


def said(figure):
    head = figure.subfigs[0]
    return [text.get_text() for text in head.texts], [t.get_text() for legend in head.legends for t in legend.texts]


def drawn(axes):
    """(x, y) of every line with more than one point."""
    return [line.get_xydata() for line in axes.lines if len(line.get_xdata()) > 1]


# --- the data behind the lines -----------------------------------------------------------------------------------


@given(
    values=st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(np.nan)), min_size=1, max_size=300),
    bins=st.integers(1, 40),
)
def test_envelope_keeps_every_peak_and_invents_nothing(values, bins):
    value = np.array(values)
    x, y, *_ = plot_style.envelope(np.arange(len(value)), value, bins)
    known = value[np.isfinite(value)]
    if not known.size:
        assert np.isnan(y).all()
        return
    assert (np.nanmin(y), np.nanmax(y)) == (known.min(), known.max())
    assert set(y[np.isfinite(y)]) <= set(known)
    assert x[np.isfinite(x)].min() >= 0 and x[np.isfinite(x)].max() < len(value)
    assert (np.diff(x[np.isfinite(x)]) >= 0).all()


def test_envelope_thins_long_series_alone_and_shows_a_peak_of_one_frame():
    value = np.zeros(100_000)
    value[70_007] = 9
    thin = plot_style.envelope(np.arange(100_000), value, 500)
    assert len(thin.y) <= 1000 and thin.y.max() == 9
    assert abs(thin.x[thin.y.argmax()] - 70_007) <= 200
    assert thin.means[1].max() == pytest.approx(9 / 200)
    assert plot_style.envelope(np.arange(1000), value[:1000], 500).means is None


@pytest.mark.parametrize("bins", [3, 1000])
def test_lines_break_where_frames_or_values_are_missing(bins):
    frame = np.r_[0:40, 80:120]
    value = np.ones(80)
    x, y, *_ = plot_style.envelope(frame, value, bins)
    assert np.isnan(y).sum() == 1 and np.isnan(x[np.isnan(y)]).all()
    holes = np.ones(120)
    holes[40:80] = np.nan
    assert np.isnan(plot_style.envelope(np.arange(120), holes, bins).y).sum() == 1
    assert not np.isnan(plot_style.envelope(np.arange(0, 400, 5), value, bins).y).any(), "every fifth frame is no gap"


def test_single_points_and_spans():
    assert plot_style.alone(np.array([1, np.nan, 2, 3, np.nan, 4])).tolist() == [True, False, False, False, False, True]
    frame = np.arange(10)
    mask = np.isin(frame, [0, 1, 2, 5, 9])
    assert plot_style.frame_spans(frame, mask) == [(-0.5, 2.5), (4.5, 5.5), (8.5, 9.5)]
    assert plot_style.frame_spans(frame, mask, 3.0) == [(-0.5, 10.5)], "near ones join"
    assert plot_style.frame_spans(np.arange(10_000), np.arange(10_000) == 50, 20) == [(40, 60)], "one frame is seen"
    assert plot_style.frame_spans(frame * 10, mask)[0] == (-5, 25)
    assert plot_style.frame_spans(frame, ~(mask | ~mask)) == []


@given(st.lists(st.lists(st.one_of(st.floats(-9, 9), st.just(np.nan)), min_size=4, max_size=4), min_size=1, max_size=9))
def test_quantiles_are_those_of_numpy(rows):
    values = np.array(rows)
    known = np.isfinite(values).any(axis=0)
    for share, found in zip((0, 0.1, 0.5, 0.9, 1), plot_style.quantiles(values, (0, 0.1, 0.5, 0.9, 1)), strict=True):
        np.testing.assert_allclose(found[known], np.nanquantile(values[:, known], share, axis=0), atol=1e-12)
        assert np.isnan(found[~known]).all()


def test_limits_hold_the_data_but_for_what_is_far_out():
    low, high = plot_style.limits([np.linspace(10, 20, 50), np.array([np.nan])])
    assert 9 < low < 10 and 20 < high < 21
    far = np.r_[np.linspace(0, 10, 500), 4000]
    assert plot_style.limits([far])[1] < 30
    assert plot_style.limits([np.r_[np.zeros(50), np.full(50, 4000)]])[1] > 4000, "half of it is no outlier"
    assert plot_style.limits([np.array([5.0])], floor=0.0)[0] == 0
    assert plot_style.limits([np.array([np.nan])]) is None
    low, high = plot_style.limits([np.full(9, 7.0)])
    assert low < 7 < high


def test_ticks_of_time_follow_the_frames_times():
    frame = np.arange(101.0)
    time_s = np.where(frame <= 50, frame / 25, 2 + (frame - 50) / 10)  # the rate changes
    places, labels = plot_style.ticks(frame, time_s)
    assert labels[:3] == ["0 s", "1 s", "2 s"] and places[:4] == pytest.approx([0, 25, 50, 60])
    assert plot_style.ticks(np.arange(9000.0), np.arange(9000) / 25)[1][:2] == ["0:00", "1:00"]
    assert plot_style.ticks(np.arange(100_000.0), np.arange(100_000) / 25)[1][1] == "0:10:00"
    assert plot_style.ticks(np.arange(3.0), np.arange(3) / 25)[1][0] == "0.00 s"
    with plot_style.style():
        axes = plot_style.new_figure(4, 3).subplots()
        backwards = track(time_s=-np.arange(60.0))
        assert not any(plot_style.second_axis(axes, table, 5) for table in (track(time_s=None), track(1), backwards))
        assert plot_style.second_axis(axes, track(), 5)


def test_labels_of_ticks_have_equal_decimals():
    assert numbers([0, 2.5, 5]) == ["0.0", "2.5", "5.0"]
    assert numbers([-0.0, 1000, -2000]) == ["0", "1,000", "−2,000"]


def test_legends_stand_in_the_page():
    labels = ["a name of some length", *(f"part {i}" for i in range(15))]
    columns, rows = columns_for(labels, 10.0)
    assert 1 < rows <= 4 and columns * rows >= len(labels)
    table = track(4, MAX_LINES)
    figure = plots.page_figure(table, pairs_of(table, status="hidden"))
    plots.render(figure, dpi=50)
    head = figure.subfigs[0]
    box = head.legends[0].get_window_extent()
    assert head.bbox.x0 <= box.x0 and box.x1 <= head.bbox.x1
    assert box.y0 > head.bbox.y0 - 8, "but for the legend's own padding"


# --- the page ----------------------------------------------------------------------------------------------------

ALL = ["x", "y", "size", "confidence", "status", "effective sample size", "spread"]


def test_measures_have_a_panel_each_with_their_spread_as_a_band():
    table = moving_face(60, noise=0.5, open=np.linspace(0, 0.3, 60))
    found = panels(plots.page_figure(table))
    names = [one.name.replace("_", " ") if one.of else f"pose: {one.name}" for one in MEASURES if one.name in USUAL]
    assert [name for name in found if name in names] == names
    axes, one = found["mouth opening"], table.measures["face"]["mouth_opening"]
    np.testing.assert_allclose(drawn(axes)[0], np.stack([one.frame, one.value], axis=1))
    low, high = (one.value + sign * one.std for sign in (-1, 1))
    corners = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert corners.min() == pytest.approx(low.min()) and corners.max() == pytest.approx(high.max())


def test_page_has_a_panel_of_what_is_known_and_no_other():
    table = track()
    assert list(panels(plots.page_figure(table))) == ALL
    assert list(panels(plots.page_figure(table, pairs_of(table)))) == [*ALL, "error"]
    opencv = track(particles=None, ess=None, std_x=None, std_y=None, confidence=None)
    assert list(panels(plots.page_figure(opencv))) == ["x", "y", "size", "status"]
    bare = track(particles=None, ess=None, std_x=None, confidence=None, status=None, w=None, angle=np.arange(60.0))
    assert list(panels(plots.page_figure(bare))) == ["x", "y", "angle"]
    assert "particles" in panels(plots.page_figure(track(ess=None)))
    nothing = dict.fromkeys(("x", "y", "w", "confidence", "status", "std_x", "particles", "ess"))
    with pytest.raises(InputError, match=r"trajectory\.csv: has no number"):
        plots.page_figure(track(**nothing))


def test_page_draws_the_values():
    table = track()
    found = panels(plots.page_figure(table, pairs_of(table)))
    x = drawn(found["x"])
    assert np.allclose(x[1], np.stack([table.parts[1].frame, table.parts[1].x], axis=1))
    assert np.allclose(x[3][:, 1], table.parts[0].x - 3), "truth comes after ours"
    assert np.allclose(drawn(found["size"])[0][:, 1], np.sqrt(12 * 14))
    assert np.allclose(drawn(found["spread"])[0][:, 1], np.sqrt(5))
    assert np.allclose(drawn(found["error"])[0][:, 1], 5)
    assert found["y"].yaxis_inverted() and not found["x"].yaxis_inverted()
    assert found["confidence"].get_ylim() == pytest.approx((-0.03, 1.06))
    assert len({tuple(axes.get_xlim()) for axes in found.values()}) == 1


def test_boxes_have_their_overlap_with_the_truth_and_absent_parts_no_error():
    table = track(parts=1).renamed("face", "box")
    found = panels(plots.page_figure(table, pairs_of(table, off=(6.0, 0.0))))
    assert list(found)[-2:] == ["error", "overlap"]
    assert np.allclose(drawn(found["overlap"])[0][:, 1], 6 / 18)
    table = track(parts=1)
    assert "error" not in panels(plots.page_figure(table, pairs_of(table, status="absent")))


def test_page_shades_what_is_lost_and_hidden():
    status = np.where(np.isin(np.arange(60), range(20, 30)), "lost", "tracked")
    table = track(status=status)
    tracked = replace(table.parts[2], status=np.where(np.arange(60) < 25, "tracked", status))
    table = joined([*table.parts[:2], tracked])
    pairs = pairs_of(table)
    pairs[0] = pairs[0]._replace(truth=replace(pairs[0].truth, status=np.where(np.arange(60) < 5, "hidden", "visible")))
    figure = plots.page_figure(table, pairs)
    found = panels(figure)
    spans = [(p.get_x(), p.get_x() + p.get_width()) for p in found["confidence"].patches]
    assert spans == [(19.5, 29.5), (24.5, 29.5)], "pale where any is lost, darker where all are"
    assert [(p.get_x(), p.get_width()) for p in found["error"].patches] == [(-0.5, 5.0)]
    texts, labels = said(figure)
    assert labels == ["part 0", "part 1", "part 2", "ground truth", "lost", "hidden in the ground truth"]
    assert "lost in 14 % of rows, 3 of 3 parts" in texts[1] and "median error 5.00 px" in texts[1]


def test_page_names_itself():
    assert said(plots.page_figure(track()))[0][0] == "clip-sir"
    named = replace(
        track(), header={"source": {"path": "a/b.mp4"}, "recipe": {"name": "sir"}, "seed": 4, "complete": False}
    )
    texts, _ = said(plots.page_figure(named))
    assert texts[0] == "b.mp4, sir"
    assert texts[1].split("   ·   ") == ["60 frames", "seed 4", "never called lost", "the run was cut short"]
    assert said(plots.page_figure(named, title="$x_1$\nmine"))[0][0] == "$x_1$?mine"


@pytest.mark.parametrize(
    ("frames", "parts", "targets"),
    [
        (1, 5, ("face",)),
        (9, 3, ("_a", "b_", "漢")),
        pytest.param(2, 1, ("",), marks=pytest.mark.nightly),
        pytest.param(40, 68, ("face",), marks=pytest.mark.nightly),
    ],
)
def test_page_of_any_shape(frames, parts, targets):
    table = track(frames, parts, targets)
    figure = plots.page_figure(table, pairs_of(table, status="hidden"), width=4.6)
    assert plots.render(figure, "png", dpi=50).startswith(b"\x89PNG") and len(panels(figure)) >= 7


def test_lines_of_one_target_differ_by_colour_and_of_several_by_their_target():
    one = lines_of(track(parts=5), [])
    assert len({line.colour for line in one}) == 5 and one[0].name == "part 0"
    several = lines_of(track(parts=2, targets=("a", "b")), [])
    assert [line.colour for line in several] == [plot_style.COLOURS[i] for i in (0, 0, 1, 1)]
    assert len({str(line.look) for line in several}) == 4
    assert [line.name for line in lines_of(track(parts=1, targets=("head", "left_hand")), [])] == ["head", "left hand"]
    ramp = lines_of(track(parts=MAX_LINES + 1), [])
    assert len({line.colour for line in ramp}) == MAX_LINES + 1


def test_many_parts_are_drawn_as_bands():
    table = track(40, 20)
    figure = plots.page_figure(table, pairs_of(table))
    found = panels(figure)
    assert len(drawn(found["x"])) == 20
    assert len(found["confidence"].collections) == 2
    values = np.stack([s.confidence for s in table.parts])
    assert np.allclose(drawn(found["confidence"])[0][:, 1], np.median(values, axis=0))
    assert said(figure)[1] == ["20 parts, part_0 to part_19"]
    crowd = plots.page_figure(track(9, 1, [f"person{n}" for n in range(20)]))
    assert said(crowd)[1][:2] == ["person0", "person1"]


def test_lost_from_start_to_end_and_nonsense_numbers():
    wild = np.r_[np.full(59, -1e300), 1e300]
    gone = track(status=np.full(60, "lost"), confidence=np.zeros(60), x=wild, w=wild, ess=wild, std_x=wild)
    figure = plots.page_figure(gone)
    assert "lost in 100 %" in said(figure)[0][1] and plots.render(figure, dpi=50)


def test_a_run_away_for_a_moment_does_not_press_the_others_flat():
    x = 100 + np.sin(np.arange(300.0))
    x[150] = 9000
    axes = panels(plots.page_figure(track(300, 1, x=x)))["x"]
    assert axes.get_ylim()[1] < 120
    assert [line.get_marker() for line in axes.lines if line.get_marker() != "None"] == ["^"], "a wedge says where"
