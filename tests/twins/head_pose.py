"""A slow, plain twin of trajectory/head.py: one frame, a loop over points, derivatives by differences.

Written from the formulas and from nothing of ours.
"""

import math

import numpy as np


def turn(pitch, yaw, roll):
    """R_x(pitch) R_y(yaw) R_z(roll)."""
    cp, sp, cy, sy, cr, sr = (f(a) for a in (pitch, yaw, roll) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return about_x @ about_y @ about_z


def seen_at(pose, point):
    """Where a point of the face is in the image, by pitch, yaw, roll, log scale, x, y."""
    return math.exp(pose[3]) * (turn(*pose[:3]) @ point)[:2] + pose[4:]


def covariance(pose, cov, spread):
    axes = turn(*pose[:3])[:2]
    return cov + math.exp(2 * pose[3]) * axes @ np.diag(np.square(spread)) @ axes.T


def fit(xy, cov, shape, spread):
    """Pitch, yaw, roll (radians), log scale, x, y of the best of several starts, and their covariance (6, 6)."""
    found = []
    size = math.log(np.ptp(xy[:, 0]) / np.ptp(shape[:, 0]))
    for pitch in (-0.5, 0.5):
        for yaw in (-0.5, 0.5):
            pose = np.array([pitch, yaw, 0.0, size, *xy.mean(axis=0)])
            for _ in range(40):
                normal, slope, cost = np.zeros((6, 6)), np.zeros(6), 0.0
                for at, c, point, s in zip(xy, cov, shape, spread, strict=True):
                    weight = np.linalg.inv(covariance(pose, c, s))
                    off = at - seen_at(pose, point)
                    slopes = np.zeros((2, 6))
                    for i in range(6):
                        more = np.zeros(6)
                        more[i] = 1e-6
                        slopes[:, i] = (seen_at(pose + more, point) - seen_at(pose - more, point)) / 2e-6
                    normal += slopes.T @ weight @ slopes
                    slope += slopes.T @ weight @ off
                    cost += off @ weight @ off - math.log(np.linalg.det(weight))
                step = np.linalg.solve(normal, slope)
                pose = pose + step * min(1.0, 0.3 / max(np.abs(step[:4]).max(), 1e-9))
            if np.abs(pose[:2]).max() < math.pi / 2:
                found.append((cost, pose, np.linalg.inv(normal)))
    return min(found, key=lambda one: one[0])[1:]
