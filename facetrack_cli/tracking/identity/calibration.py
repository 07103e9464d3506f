"""From scores to probabilities and thresholds: Platt's logistic regression, the threshold of equal errors."""

from __future__ import annotations

import numpy as np

from facetrack_cli.core.types import Array


def logistic(score: Array, slope: float, offset: float) -> Array:
    """1 / (1 + exp(-(slope score + offset))), without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * (slope * score + offset))))


def fit_logistic(positive: Array, negative: Array) -> tuple[float, float]:
    """Slope (never below 0) and offset of the probability of being positive, both classes equally frequent.

    Platt (1999) with his targets, (n + 1) / (n + 2) and 1 / (n + 2), by which classes that do not overlap have a finite
    slope. A score that says nothing has slope 0 and probability 1/2. By Newton's method, its steps halved where they
    do not help (Lin, Lin & Weng 2007).
    """
    score = np.concatenate([positive, negative])
    # in units of the middle of both classes, since densities of negatives go down without a bound
    centre = 0.5 * (np.median(positive) + np.median(negative))
    unit = max(0.5 * abs(float(np.median(positive) - np.median(negative))), 1e-9)
    z = np.clip((score - centre) / unit, -50.0, 50.0)
    p, n = len(positive), len(negative)
    target = np.concatenate([np.full(p, (p + 1) / (p + 2)), np.full(n, 1 / (n + 2))])
    weight = np.concatenate([np.full(p, 0.5 / p), np.full(n, 0.5 / n)])
    design = np.stack([z, np.ones_like(z)], axis=1)

    def loss(a: Array) -> float:
        t = design @ a
        return float((weight * (np.logaddexp(0.0, t) - target * t)).sum() + 1e-6 * (a @ a))

    a = np.zeros(2)
    for _ in range(100):
        probability = logistic(design @ a, 1.0, 0.0)
        gradient = design.T @ (weight * (probability - target)) + 2e-6 * a
        curvature = (design.T * (weight * probability * (1 - probability))) @ design + 2e-6 * np.eye(2)
        step = np.linalg.solve(curvature, gradient)
        size = 1.0
        while size > 1e-6 and loss(a - size * step) > loss(a):
            size /= 2
        a = a - size * step
        if np.abs(size * step).max() < 1e-9:
            break
    if a[0] <= 0.0:
        return 0.0, 0.0
    slope = float(a[0] / unit)
    return slope, float(a[1] - slope * centre)


def equal_errors(genuine: Array, impostor: Array) -> tuple[float, float]:
    """The threshold at which as large a share of the genuine is below it as of the impostors above, and that share."""
    at = np.unique(np.concatenate([genuine, impostor]))
    at = np.concatenate([at[:1] - 1.0, (at[1:] + at[:-1]) / 2, at[-1:] + 1.0])
    missed = np.searchsorted(np.sort(genuine), at) / len(genuine)
    passed = 1.0 - np.searchsorted(np.sort(impostor), at) / len(impostor)
    gap = np.abs(missed - passed)
    # the middle of all thresholds that serve as well
    best = np.flatnonzero(gap <= gap.min() + 1e-12)
    k = best[len(best) // 2]
    low, high = at[best[0]], at[best[-1]]
    threshold = float((low + high) / 2) if len(best) > 1 else float(at[k])
    return threshold, float((missed[k] + passed[k]) / 2)
