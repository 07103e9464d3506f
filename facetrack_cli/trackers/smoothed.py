"""Rows of a trajectory from smoothed beliefs: of a whole run, or of each frame some frames later (fixed lag).

A filter leaves a belief a frame, mean and covariance of its particles, and the motion by which it came there. Backward
from the last frame, with m, P the belief of frame t, m', P' what the motion makes of it in frame t + 1, and m_s, P_s
the smoothed belief of that frame (Rauch, Tung & Striebel, AIAA Journal 1965; Särkkä, Bayesian Filtering and Smoothing,
2013, section 8.2):

    m' = A m + o,  P' = A P A^T + Q,  G = P A^T P'^-1
    m <- m + G (m_s - m'),  P <- P + G (P_s - P') G^T

The parts are smoothed apart. A frame that did not show a part says nothing of it: its belief becomes the prediction
from the last frame that did, so that between that frame and the next that does, the result is the bridge of the motion,
along with the parts that are seen meanwhile (ours).
Where a correction placed a target, its belief has no covariance, and nothing comes over it.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, pairwise, repeat
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.geometry import shown_angle
from facetrack_cli.core.types import BOX, Array, Mask
from facetrack_cli.engine.protocols import Belief, Linear
from facetrack_cli.trackers.face.stabilized import FACE, MIDDLE
from facetrack_cli.trajectory.diagnostics import AFFINE, SCALE, Diagnostics, outlines
from facetrack_cli.trajectory.trajectory import SPREAD, UNSEEN, FrameResult, Trajectory, successive

# of expectation and maximisation; more make errors larger again, which last from frame to frame
ROUNDS = 5
TAIL: Final = 1.0  # degrees of freedom of steps in `steadied`
_MIN_VARIANCE: Final = 1e-9  # of a variance: what is less is rounding
_TINY: Final = 1e-12
_Moments: TypeAlias = tuple[Array, Array]  # means (T, K, D), covariances (T, K, D, D)
Beliefs: TypeAlias = Sequence[tuple[Belief, ...]]
_SMOOTHED: Final = ("x", "y", "w", "h", "angle", *SPREAD)


def smoothed_rows(rows: Trajectory, beliefs: Beliefs) -> Trajectory:
    """The rows of one target in T frames given all of them; `beliefs` (T,) are those of the frames, () where absent.

    Rows that a correction gave, absent ones, and those of a part that is never seen again stay as they are.
    """
    return _SmoothedTarget(rows, beliefs, aspect=rows.pixel_aspect).rows()


def renamed_hands(rows: Trajectory, beliefs: Mapping[str, Beliefs]) -> tuple[Trajectory, dict[str, Beliefs]]:
    """The rows and the beliefs of all targets, those of two hands exchanged in frames whose names later frames deny.

    Where one hand was corrected, both have a filter of their own; names are not exchanged across that frame.
    """
    hands = [name for name, each in beliefs.items() if any(belief and belief[0].named is not None for belief in each)]
    if len(hands) != 2:
        return rows, dict(beliefs)
    p, exchanged, held = (np.full(len(rows.frames), value) for value in (1.0, 0.0, 0.0))
    for t, pair in enumerate(zip(*(beliefs[name] for name in hands), strict=True)):
        named = [belief[0].named for belief in pair if belief and belief[0].named is not None]
        if not named:
            p[t] = p[t - 1]
        elif len(named) == 2 and (named[0] != named[1]).any():
            held[t], exchanged[t] = 1.0, 0.5
        else:
            p[t], exchanged[t] = named[0]
    changed = (smoothed_names(p, exchanged) < 0.5) & (held == 0)
    first, second = (np.flatnonzero(rows.which == rows.names.index((name, BOX)))[changed] for name in hands)
    order = np.arange(len(rows))
    order[first], order[second] = second, first
    ours, theirs = (beliefs[name] for name in hands)
    both = {
        name: [b if turned else a for a, b, turned in zip(side, other, changed, strict=True)]
        for name, side, other in zip(hands, (ours, theirs), (theirs, ours), strict=True)
    }
    return replace(rows.take(order), which=rows.which), {**beliefs, **both}


def lagged(results: Iterable[FrameResult], lag: int) -> Iterator[FrameResult]:
    """Each result when `lag` more are there, at the end when there are no more, with rows that take them into account.

    They are those of `smoothed_rows` of all frames up to then, where no part takes longer than `lag` frames to be lost.
    """
    kept = deque[FrameResult]()
    before: list[tuple[Belief, ...]] = []  # of the first of `kept`, which stays until the next one is done
    for result in chain(results, repeat(None, lag)):
        if result is not None:
            kept.append(result)
        at = 1 if before else 0
        if len(kept) - at <= (lag if result is not None else 0):
            continue
        now, targets, after = kept[at], [], []
        for i, target in enumerate(now.targets):
            rows = successive([each.targets[i].rows for each in kept])
            beliefs = [() if (beliefs_of := each.targets[i].beliefs) is None else beliefs_of() for each in kept]
            smoother = _SmoothedTarget(rows, beliefs, before[i] if before else (), lag=True, aspect=now.frame.aspect)
            frame = now.frame.index
            targets.append(target._replace(rows=smoother.rows().between(frame, frame + 1)))
            after.append(smoother.carried(at))
        if before:
            kept.popleft()
        before = after
        yield FrameResult(now.frame, tuple(targets))


class _SmoothedTarget:
    """One target over T frames; its K parts in columns (T, K)."""

    def __init__(
        self, rows: Trajectory, beliefs: Beliefs, carried: Sequence[Belief] = (), *, lag: bool = False, aspect: float
    ) -> None:
        """`carried` replaces the beliefs of the first frame, if parts were lost in the frames before it.

        `aspect` is the width of a pixel over its height.
        """
        self.all, k, t, self.lag, self.aspect = rows, len(rows.names), len(beliefs), lag, aspect
        self.reported = rows.diagnostics.get(rows.target)
        table = {name: getattr(rows, name).reshape(k, t).T for name in (*_SMOOTHED, "status", "by_hand")}
        self.of = table
        self.gone: Mask = np.isnan(table["x"])
        lost: Mask = np.isin(table["status"], UNSEEN)
        placed = (table["by_hand"] | (table["status"] == "init")).any(axis=1)
        self.fixed: Mask = self.gone | placed[:, None]
        first = next((each for each in beliefs if each), ())
        whole = [each or first for each in beliefs]
        if carried:
            whole[0], lost[0] = tuple(carried), np.concatenate([belief.doubt for belief in carried])
            placed[0] = False
        self.sizes = [len(belief.mean) for belief in first]
        ends = np.cumsum([0, *self.sizes])
        self.chains: list[Chain] = []
        for i, (a, b) in enumerate(pairwise(ends.tolist())):
            of = [each[i] for each in whole]
            # a calibration may call a part lost that the filter sees: then nothing is in doubt
            lost[:, a:b] &= np.stack([belief.doubt for belief in of])
            self.chains.append(chained(of, lost[:, a:b], self.gone[:, a:b], placed))

    def rows(self) -> Trajectory:
        if not self.chains:
            return self.all
        columns = {name: self.of[name].copy() for name in _SMOOTHED}
        # of a face points, box, and a network's points
        head = self.chains[min(len(self.chains) - 1, 1)]
        before, box = [head], BOX in [part for _, part in self.all.names]
        after = [smoothed(head)]
        if len(self.chains) > 1:
            others = [each for each in self.chains if each is not head]
            points = Chain(*(np.concatenate(each, axis=1) for each in zip(*others, strict=True)))
            before, after = [points, head], [self._face(columns, points, head, *after[0]), *after]
        elif box and before[0].mean.shape[-1] > 2:
            self._box(columns, before[0], *after[0])
        else:
            columns |= _places(*after[0])
        unseen, linked = (np.concatenate([getattr(x, key) for x in self.chains], 1) for key in ("unseen", "linked"))
        keep = self.fixed | (unseen & ~linked)
        shown = {name: np.where(keep, self.of[name], columns[name]).T.ravel() for name in _SMOOTHED}
        diagnostics = self._diagnostics(before, after, keep[:, self.sizes[0] if len(self.sizes) > 1 else -1])
        rows = replace(self.all, **shown, diagnostics=diagnostics, corners=None)
        return replace(rows, corners=outlines(rows))

    def _box(self, columns: dict[str, Array], before: Chain, mean: Array, cov: Array) -> None:
        columns |= _places(mean, cov)
        sides, state, reported = {"w": [2], "h": [2]}, before.mean, self.reported
        affine = reported is not None and AFFINE.name in reported.values
        if reported is not None and affine:
            # of the rows' state, which may be that of the best particle
            sides, state = {"w": [2, 4], "h": [3, 5]}, np.full_like(before.mean, np.nan)
            state[np.searchsorted(self.all.frames, reported.frame), 0, 2:] = reported.values[AFFINE.name][:, :4]
        for side, at in sides.items():
            old, new = (np.linalg.norm(each[..., at], axis=-1) for each in (state, mean))
            way, size = mean[..., at] / new[..., None], self.of[side] / old
            var = np.einsum("tki,tkij,tkj->tk", way, cov[..., at, :][..., at], way)
            columns |= {side: size * new, f"std_{side}": size * np.sqrt(np.maximum(var, 0.0))}
        if affine:
            a1, a2, a3, a4 = (mean[..., i] for i in range(2, 6))
            columns["angle"] = shown_angle(np.degrees(np.arctan2(a3 - a2, a1 + a4)), self.aspect)

    def _face(self, columns: dict[str, Array], points: Chain, head: Chain, boxes: Array, box_cov: Array) -> _Moments:
        """Points of a stabilized image, which the box leads to the frame, where head and box become `boxes`.

        What a point's filter corrects of its head's noise must not come apart from it: the points are smoothed in the
        stabilized image of the smoothed head, in which they first are where they were in the frame.
        """
        k, parts = self.sizes[0], np.delete(np.arange(len(self.all.names)), self.sizes[0])
        ratio = boxes[:, 0, 2] / head.mean[:, 0, 2]
        place = np.nan_to_num(np.stack([self.of["x"][:, k], self.of["y"][:, k]], axis=1))  # nan where it is absent
        moved = boxes[:, 0, :2] + (place - head.mean[:, 0, :2]) * ratio[:, None]
        angle = np.radians(shown_angle(np.nan_to_num(self.of["angle"][:, k]), 1 / self.aspect))
        scale = np.nan_to_num(np.sqrt(self.of["w"][:, k] * self.of["h"][:, k]), nan=FACE) / FACE
        turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
        old, new = (each[:, None, None] * turn for each in (scale, scale * ratio))
        was = np.einsum("tde,tke->tkd", old, points.mean - MIDDLE) + place[:, None]
        mean = np.einsum("tde,tke->tkd", np.linalg.inv(new), was - moved[:, None]) + MIDDLE
        still, cov = smoothed(points._replace(mean=mean, cov=points.cov / ratio[:, None, None, None] ** 2))
        now = np.einsum("tde,tke->tkd", new, still - MIDDLE) + moved[:, None]
        # what the rows have beside the filter's mean and covariance is kept
        at = np.stack([self.of["x"][:, parts], self.of["y"][:, parts]], axis=-1) + now - was
        if not self.lag:
            # in the frame, where what the head's filter and the points' correct of each other is no jitter
            at = steadied(at, ~points.unseen & ~self.gone[:, parts])
        x, y, xy = (np.nan_to_num(self.of[name][:, parts]) for name in ("std_x", "std_y", "cov_xy"))
        rows = np.stack([x**2, xy, xy, y**2], axis=-1).reshape(*x.shape, 2, 2)
        seen = rows + _mapped(new, cov) - _mapped(old, points.cov)
        hidden = _mapped(new, cov) + box_cov[..., :2, :2]
        values, vectors = np.linalg.eigh(np.where(points.unseen[..., None, None], hidden, seen))
        spread = vectors * np.maximum(values, 1e-6)[..., None, :] @ np.swapaxes(vectors, -1, -2)
        place, cov_of = (
            np.concatenate([each[:, :k], of_box, each[:, k:]], axis=1)
            for each, of_box in ((at, moved[:, None]), (spread, box_cov[..., :2, :2]))
        )
        columns |= _places(place, cov_of)
        for side in ("w", "h"):
            columns[side] = self.of[side] * ratio[:, None]
            columns[f"std_{side}"][:, k] = self.of[side][:, k] * np.sqrt(box_cov[:, 0, 2, 2]) / head.mean[:, 0, 2]
        return still, cov

    def _diagnostics(self, before: Sequence[Chain], after: Sequence[_Moments], keep: Mask) -> Mapping[str, Diagnostics]:
        """Those that tell of place and size as the rows do; all others are the filter's."""
        reported, (mean, _) = self.reported, after[-1]
        if reported is None or (len(after) == 1 and AFFINE.name not in reported.values):
            return self.all.diagnostics
        at = np.searchsorted(self.all.frames, reported.frame)  # there are none of frames in which it is absent
        values, mean, keep = dict(reported.values), mean[at, 0], keep[at]
        if len(after) == 1:
            affine = np.concatenate([mean[:, 2:], mean[:, :2]], axis=1)
            values[AFFINE.name] = np.where(keep[:, None], values[AFFINE.name], affine)
            scale = np.sqrt(0.5 * np.square(mean[:, 2:]).sum(axis=1))
        else:
            scale = values[SCALE.name] * mean[:, 2] / before[-1].mean[at, 0, 2]
        values[SCALE.name] = np.where(keep, values[SCALE.name], scale)
        return {**self.all.diagnostics, self.all.target: replace(reported, values=values)}

    def carried(self, at: int) -> tuple[Belief, ...]:
        """The beliefs of a frame, with predictions of the parts that it did not show."""
        beliefs = []
        for mean, cov, *motion, unseen, _, _ in map(bridged, self.chains):
            beliefs.append(Belief(mean[at], cov[at], Linear(*(each[at] for each in motion)), unseen[at]))
        return tuple(beliefs)


def _mapped(matrix: Array, cov: Array) -> Array:
    return np.asarray(matrix[:, None] @ cov @ np.swapaxes(matrix, 1, 2)[:, None])


def _places(mean: Array, cov: Array) -> dict[str, Array]:
    """Columns of the places in `mean` (T, K, D) and `cov` (T, K, D, D)."""
    std_x, std_y = (np.sqrt(np.maximum(cov[..., i, i], 0.0)) for i in (0, 1))
    return {"x": mean[..., 0], "y": mean[..., 1], "std_x": std_x, "std_y": std_y, "cov_xy": cov[..., 0, 1]}


# --- the posterior of each frame given all frames, p(x_t | Y_T)


class Chain(NamedTuple):
    """Beliefs of T frames: `mean` (T, K, D), `cov` (T, K, D, D); of the motions into each frame the same as `Linear`.

    Of (T, K) are `unseen`, whether the frame did not show the part; `joined`, whether there is a belief of it in this
    frame and in the one before; `linked`, whether it also says something of the frame before.
    """

    mean: Array
    cov: Array
    matrix: Array
    offset: Array
    noise: Array
    unseen: Mask
    joined: Mask
    linked: Mask


def smoothed_names(p: Array, exchanged: Array) -> Array:
    """(T,): the probability, given all T frames, of the one of two states that was filtered to `p` (T,); `exchanged`
    (T,) is the probability that the state of a frame is not that of the frame before.
    """
    posterior = p.copy()
    for t in range(len(p) - 1, 0, -1):
        stay, change = p[t - 1] * (1 - exchanged[t]), p[t - 1] * exchanged[t]
        ahead = stay + (1 - p[t - 1]) * exchanged[t]
        posterior[t - 1] = stay * posterior[t] / max(ahead, _TINY) + change * (1 - posterior[t]) / max(1 - ahead, _TINY)
    return posterior


def chained(beliefs: Sequence[Belief], lost: Mask, gone: Mask, by_hand: Mask) -> Chain:
    """Of beliefs of T frames; `lost` (T, K) as the tracker judged, `gone` where there is no part to know of.

    In the frames `by_hand` (T,) corrections placed the parts. A part is `lost` only after some frames in doubt,
    which did not show it either. Those of the last stretch, after which it is never seen again, say nothing of what
    was before.
    """
    unseen = lost & ~gone & ~by_hand[:, None]
    seen_later = np.zeros_like(unseen)
    for t in range(len(unseen) - 2, -1, -1):
        unseen[t] |= unseen[t + 1] & beliefs[t].doubt & ~gone[t] & ~by_hand[t]
        seen_later[t] = ~gone[t + 1] & (~unseen[t + 1] | seen_later[t + 1])
    joined = np.zeros_like(unseen)
    joined[1:] = ~gone[1:] & ~gone[:-1]
    mean, cov = (np.stack([getattr(belief, name) for belief in beliefs]) for name in ("mean", "cov"))
    matrix, offset, noise = (np.stack(each) for each in zip(*(belief.motion for belief in beliefs), strict=True))
    # what a frame does not show moves with the parts that it shows
    shown = joined & ~unseen
    shown[1:] &= ~unseen[:-1] & ~by_hand[1:, None]
    for t in np.flatnonzero(shown.any(axis=1) & (joined & ~shown).any(axis=1)).tolist():
        offset[t, joined[t] & ~shown[t]] += (mean[t] - mean[t - 1])[shown[t]].mean(axis=0)
    return Chain(mean, cov, matrix, offset, noise, unseen, joined, joined & (~unseen | seen_later))


def bridged(beliefs: Chain) -> Chain:
    """With predictions in place of the beliefs of frames that did not show a part."""
    mean, cov = beliefs.mean.copy(), beliefs.cov.copy()
    for t in np.flatnonzero((beliefs.unseen & beliefs.joined).any(axis=1)).tolist():
        hidden = beliefs.unseen[t] & beliefs.joined[t]
        ahead, spread = _predicted(beliefs, t, mean[t - 1], cov[t - 1])
        mean[t, hidden], cov[t, hidden] = ahead[hidden], spread[hidden]
    return beliefs._replace(mean=mean, cov=cov)


def smoothed(beliefs: Chain) -> tuple[Array, Array]:
    """(T, K, D) means and (T, K, D, D) covariances given all T frames."""
    beliefs = bridged(beliefs)
    mean, cov = beliefs.mean, beliefs.cov
    for t in range(len(mean) - 1, 0, -1):
        if not beliefs.linked[t].any():
            continue
        ahead, spread = _predicted(beliefs, t, mean[t - 1], cov[t - 1])
        gain = cov[t - 1] @ beliefs.matrix[t].mT @ _inverse(spread)
        gain[~beliefs.linked[t]] = 0.0
        mean[t - 1] += np.einsum("kde,ke->kd", gain, mean[t] - ahead)
        new = cov[t - 1] + gain @ (cov[t] - spread) @ gain.mT
        cov[t - 1] = (new + new.mT) / 2
    return mean, cov


def _predicted(beliefs: Chain, t: int, mean: Array, cov: Array) -> tuple[Array, Array]:
    """What the motion into frame t makes of mean (K, D) and covariance (K, D, D)."""
    matrix = beliefs.matrix[t]
    ahead = np.einsum("kde,ke->kd", matrix, mean) + beliefs.offset[t]
    return ahead, matrix @ cov @ matrix.mT + beliefs.noise[t]


def steadied(at: Array, shown: Mask) -> Array:
    """Places (T, K, 2) without their jitter, where two successive frames have `shown` (T, K) a part.

    The places are a random walk with steps of Student's t, seen with normal noise: what rests is smoothed, and what
    moves stays as it is. Noise and steps are those of each part in the clip. The t is a normal density whose variance
    differs from frame to frame, and that is a hidden variable, too (Lange, Little & Taylor, Journal of the American
    Statistical Association 1989): expectation and maximisation find it, with a smoother of known variances within.
    """
    joined = shown[1:] & shown[:-1]
    bends = np.where(joined[1:] & joined[:-1], np.sum((at[2:] - 2 * at[1:-1] + at[:-2]) ** 2, axis=2), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of parts that are never seen thrice
        noise = np.nan_to_num(np.nanmedian(bends, axis=0)) / (6 * 2 * math.log(2)) + _MIN_VARIANCE
    step, wide, smooth = noise.copy(), np.ones(joined.shape), at
    for _ in range(ROUNDS):
        var, smooth = np.empty(shown.shape), at.copy()
        var[0] = noise
        for t in range(1, len(at)):
            ahead = np.where(joined[t - 1], var[t - 1] + step * wide[t - 1], np.inf)
            gain = 1 / (1 + noise / ahead)
            var[t] = gain * noise
            before = np.where(joined[t - 1][:, None], smooth[t - 1], at[t])  # there may be none
            smooth[t] = before + gain[:, None] * (at[t] - before)
        moved = np.zeros(joined.shape)
        for t in range(len(at) - 2, -1, -1):
            ahead = var[t] + step * wide[t]
            gain = np.where(joined[t], var[t] / ahead, 0.0)
            moved[t] = var[t + 1] * (1 - gain) ** 2 + gain * step * wide[t]
            smooth[t] += gain[:, None] * np.where(joined[t][:, None], smooth[t + 1] - smooth[t], 0.0)
            var[t] += gain**2 * (var[t + 1] - ahead)
        moved += 0.5 * np.sum((smooth[1:] - smooth[:-1]) ** 2, axis=2)
        wide = np.where(joined, (TAIL + 2 * moved / step) / (TAIL + 2), 1.0)
        step = np.sum(moved / wide, axis=0, where=joined) / np.maximum(joined.sum(axis=0), 1) + _MIN_VARIANCE
    return smooth


def _inverse(cov: Array) -> Array:
    """The inverse of covariances (..., D, D), on their support."""
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    scale = np.where(scale > 1e-12, scale, 1.0)
    both = scale[..., None] * scale[..., None, :]
    return np.asarray(np.linalg.pinv(cov / both, rcond=_MIN_VARIANCE, hermitian=True) / both)
