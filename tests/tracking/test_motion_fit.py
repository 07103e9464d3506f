"""Motion learned from tracks: known dynamics are recovered, a plain Kalman filter agrees, the block makes a recipe."""

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.seeds import Plan, run_plans
from facetrack_cli.tracking.models import motion_fit
from facetrack_cli.tracking.models.motion_fit import Dynamics, as_yaml, fit_dynamics, fit_motion, log_likelihood
from facetrack_cli.tracking.start.init_file import read_init
from tests.support.samples import FOLDER

TRUE = Dynamics(speed=0.8, share=0.4, step=0.05, jitter=0.02)
HEADER = "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,particles,ess,identity,identity_prob"


def simulated(rng, one, frames, tracks):
    """(T,) tracks of a value drawn by A and B alone, annotated with jitter."""
    found = []
    for _ in range(tracks):
        state, values = np.zeros(2), []
        for _ in range(frames):
            state = one.A @ state + one.B @ rng.standard_normal(2)
            values.append(state[0] + one.jitter * rng.standard_normal())
        found.append(np.array(values))
    return found


def plain(y, d, w, r, s2):
    """The log-likelihood of one track by a Kalman filter in matrices."""
    a, q = np.array([[1, d], [0, d]]), s2 * np.array([[1, w], [w, w]])
    mean, cov, total = np.zeros(2), s2 * np.diag([r, w / (1 - d * d)]), 0.0
    for value in y[1:]:
        mean, cov = a @ mean, a @ cov @ a.T + q
        if np.isnan(value):
            continue
        f, off = cov[0, 0] + r * s2, value - mean[0]
        total += -0.5 * (off**2 / f + np.log(2 * np.pi * f))
        mean, cov = mean + cov[:, 0] / f * off, cov - np.outer(cov[:, 0], cov[0]) / f
    return total


def table(path, boxes, status=None):
    """A file of ground truth with (T, 4) centres and sizes of one box."""
    status = ["visible"] * len(boxes) if status is None else status
    rows = [
        f"{i},,face,box,{x:.4f},{y:.4f},{w:.4f},{h:.4f},,,{said},,,,,,"
        for i, ((x, y, w, h), said) in enumerate(zip(boxes, status, strict=True))
    ]
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return path


@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_known_dynamics_are_recovered(jitter):
    one = TRUE._replace(jitter=jitter)
    found = fit_dynamics(simulated(np.random.default_rng(0), one, 400, 12))
    assert np.abs(found.A - one.A).max() < 0.05
    assert np.abs(found.B @ found.B.T - one.B @ one.B.T).max() < 0.15 * one.step**2
    assert abs(found.jitter - jitter) < 0.01 and not found.clipped


def test_noise_has_full_rank_and_dynamics_are_stable_whatever_the_track():
    rng = np.random.default_rng(1)
    ramp, walk = np.arange(300.0) ** 2, np.cumsum(rng.standard_normal(300))
    for track in (ramp, walk, rng.standard_normal(300), np.sin(np.arange(300.0) / 9), np.zeros(30)):
        one = fit_dynamics([track])
        assert np.abs(np.linalg.eigvals(one.A)).max() <= 1 + 1e-12
        assert one.B[0, 1] == 0 and np.linalg.cond(one.B) < 25 and one.B[0, 0] >= motion_fit.MIN_SIGMA
    assert fit_dynamics([ramp]).clipped


def test_the_likelihood_is_that_of_a_plain_filter_with_gaps():
    rng = np.random.default_rng(2)
    y = np.column_stack(simulated(rng, TRUE, 60, 2))
    y -= y[0]
    y[rng.random(y.shape) < 0.3] = np.nan
    y[0] = 0
    candidates = np.array([[0.8, 0.4, 0.2], [0.3, 0.9, 0.01], [0.0, 0.05, 5.0]])
    found, scale = log_likelihood(y, *candidates.T)
    for value, s2, each in zip(found, scale, candidates, strict=True):
        assert value == pytest.approx(sum(plain(column, *each, s2) for column in y.T), rel=1e-9)
        near = [sum(plain(column, *each, s2 * factor) for column in y.T) for factor in (0.9, 1.1)]
        assert value > max(near), "the scale is that of the greatest likelihood"


def test_hidden_rows_and_gaps_are_left_out(tmp_path):
    rng = np.random.default_rng(3)
    x, y = (100 + 60 * one for one in simulated(rng, TRUE, 400, 2))
    boxes = np.column_stack([x, y, np.full((400, 2), 60.0)])
    clean = fit_motion([table(tmp_path / "clean.csv", boxes)])
    spoilt, status = boxes.copy(), np.array(["visible"] * 400)
    spoilt[50:60, 0] += 500
    status[50:60] = "hidden"
    status[200:260] = "absent"  # a gap after which the track begins anew
    found = fit_motion([table(tmp_path / "spoilt.csv", spoilt, status)])
    assert found.steps == 399 - 11 - 61
    assert found.walk[0] == pytest.approx(clean.walk[0], rel=0.15)
    assert found.position.step == pytest.approx(clean.position.step, rel=0.25)
    assert "scale moves less than the least noise" in as_yaml(found)


def test_a_walk_of_points_is_measured_by_part_without_jitter(tmp_path):
    rng = np.random.default_rng(4)
    rows = []
    sigma = {"nose": 0.02, "mouth_left": 0.05, "mouth_right": 0.03}
    place = {name: 40.0 * i + 100 + np.zeros(2) for i, name in enumerate(sigma)}
    for t in range(3000):
        for name, step in sigma.items():
            place[name] = place[name] + (t > 0) * 80 * np.sqrt(2) * step * rng.standard_normal(2)
            x, y = place[name] + (t > 0) * rng.standard_normal(2)
            rows.append(f"{t},,face,{name},{x:.3f},{y:.3f},,,,,visible,,,,,,")
    (tmp_path / "a.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    found = fit_motion([tmp_path / "a.csv"])
    assert found.walk == pytest.approx(sigma, rel=0.06)
    assert "sigma: {nose: 0.0" in as_yaml(found)
    assert list(fit_motion([tmp_path / "a.csv"]).walk) == list(sigma)


def test_what_cannot_be_learned_from_is_refused(tmp_path):
    path = table(tmp_path / "a.csv", np.full((5, 4), 50.0))
    with pytest.raises(InputError, match=r"4 steps .* annotate at least 10"):
        fit_motion([path])
    both = path.read_text() + "0,,face,nose,1,2,,,,,visible,,,,,,\n"
    (tmp_path / "both.csv").write_text(both)
    with pytest.raises(InputError, match="boxes and points; choose one of them with --target"):
        fit_motion([tmp_path / "both.csv"])


@pytest.mark.parametrize(
    ("recipe", "clip"), [("histogram", "hands"), ("factorized", "expressions")], ids=["boxes", "points"]
)
def test_the_block_makes_a_recipe_that_runs(tmp_path, recipe, clip):
    block = as_yaml(fit_motion([FOLDER / f"{clip}.truth.csv"]))
    text = (load_recipe(recipe).path).read_text(encoding="utf-8")
    before, _, rest = text.partition("motion:\n")
    path = tmp_path / "fitted.yaml"
    path.write_text(before + block + rest[rest.index("likelihood:") :], encoding="utf-8")
    fitted = load_recipe(str(path))
    video = FOLDER / f"{clip}.mp4"
    [ended] = run_plans([Plan("fitted", video, fitted, read_init(video.with_suffix(".init.yaml")), (0,), 8)])
    assert ended.error is None and np.isfinite(ended.runs[0].trajectory.x).all()
