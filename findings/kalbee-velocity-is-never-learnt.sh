#!/usr/bin/env bash
# A head that moves at 3 pixels a frame has the velocity 0 for ever, and is left behind.
#
# Found: the Rao-Blackwellized particle filter of kalbee 1.0.0 keeps a Kalman filter of the linear states in each particle, which
# are "estimated analytically" by its documentation. It moves their means by the transition that it is given, but their covariance
# by the identity: what should be the transition's derivative is a matrix of ones on the diagonal, whatever the transition is.
# Place and velocity so never become correlated, no measured place says anything about the velocity, and the velocity stays where it
# began, with a variance that only grows. Of a head that moves steadily the place lags more and more, and its standard deviation
# (.3 pixels) says that it is right. kalbee's own Kalman filter has the velocity after five frames.
# Nothing is said. Take the Kalman filter for each particle yourself, or all of the state as particles.
# Packages: kalbee 1.0.0, numpy 2.4.6, scipy 1.17.1.
# Data: places of a head that moves by 3 pixels a frame, measured with a deviation of 1, made here. The filter's nonlinear state
# stands still, and nothing depends on it, so that the Kalman filter is exact.
# Output seen:
#   frame 5 at 15: particles 9.0 velocity 0.0 (variance 10.0), Kalman 14.8 velocity 2.9 (variance 0.1)
#   frame 10 at 30: particles 17.5 velocity 0.0 (variance 10.0), Kalman 29.8 velocity 2.9 (variance 0.0)
#   frame 40 at 120: particles 92.7 velocity 0.0 (variance 10.0), Kalman 120.5 velocity 3.1 (variance 0.0)
#   covariance of place and velocity: particles 0.0, Kalman 0.028; deviation of the place: particles 0.31
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check kalbee==1.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys

import numpy as np
from kalbee import KalmanFilter
from kalbee.modules.filters.rbpf import RaoBlackwellizedParticleFilter

MOVE = np.array([[1.0, 1.0], [0.0, 1.0]])
PLACE = np.array([[1.0, 0.0]])
NOISE, MEASURED, START = np.diag([0.01, 0.001]), np.array([[1.0]]), np.diag([10.0, 10.0])
STILL = np.array([[1e-6]])

np.random.seed(0)
particles = RaoBlackwellizedParticleFilter(
    200,
    linear_dim=2,
    nonlinear_dim=1,
    transition_function_linear=lambda linear, nonlinear, dt: MOVE @ linear,
    transition_function_nonlinear=lambda nonlinear, dt: nonlinear,
    measurement_function=lambda state: state[:1],
    process_noise_linear=NOISE,
    process_noise_nonlinear=STILL,
    measurement_noise=MEASURED,
    initial_linear_mean=np.zeros((2, 1)),
    initial_linear_cov=START,
    initial_nonlinear_mean=np.zeros((1, 1)),
    initial_nonlinear_cov=STILL,
)
kalman = KalmanFilter(np.zeros((2, 1)), START, MOVE, NOISE, PLACE, MEASURED)
noise = np.random.default_rng(0)
seen = []
for frame in range(1, 41):
    measured = np.array([[3.0 * frame + noise.normal()]])
    for one in (particles, kalman):
        one.predict()
        one.update(measured)
    if frame in (5, 10, 40):
        rows = []
        for one, covariance in ((particles, particles.linear_covs[0]), (kalman, kalman.P)):
            place, velocity = one.x[:2, 0]
            rows.append((round(float(place), 1), round(float(velocity), 1), round(float(covariance[1, 1]), 1)))
        seen.append(rows)
        told = [f"{name} {row[0]} velocity {row[1]} (variance {row[2]})" for name, row in zip(("particles", "Kalman"), rows)]
        print(f"frame {frame} at {3 * frame}: {', '.join(told)}")
covariances = [round(float(one[0, 1]), 3) for one in (particles.linear_covs[0], kalman.P)]
deviation = round(float(particles.linear_covs[0][0, 0]) ** 0.5, 2)
print(f"covariance of place and velocity: particles {covariances[0]}, Kalman {covariances[1]};", end=" ")
print(f"deviation of the place: particles {deviation}")
behind = [3 * frame - rows[0][0] for frame, rows in zip((5, 10, 40), seen)]
wrong = all(rows[0][1:] == (0, 10) for rows in seen) and behind[0] > 4 and behind[1] > 10 and behind[2] > 20
right = all(abs(rows[1][1] - 3) < 0.2 for rows in seen)
sys.exit(not (wrong and right) or covariances != [0, 0.028] or deviation != 0.31)
PYTHON
