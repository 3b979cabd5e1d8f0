# SPDX-License-Identifier: BSD-3-Clause
"""What runs compiled at the rate of the sensors, against plain Python and against the equations it solves."""

import os
import subprocess
import sys

import numpy as np
import pytest

from coman_reduced_model.core.model.trunk.contact import Linear, State, make_solver, step_soles
from coman_reduced_model.core.model.trunk.kinematics import (
    project_dynamics,
    terms_of,
    terms_size,
)

PREDICTIONS = """
import sys
import numpy as np
import coman_reduced_model as coman

rows, changes = [], {"model.trunk_rotation": sys.argv[2], "monitor.enabled": False}
for p in coman.predict(coman.bag_path("test1"), coman.load_config().replaced(changes)):
    ahead = [each.com for each in p.horizons] + [each.joints for each in p.deflections]
    rows.append(np.concatenate([p.measured_com, p.predicted_com, p.predicted_tilt, *ahead]))
    if len(rows) == 50:
        break
np.save(sys.argv[1], rows)
"""


@pytest.mark.slow
@pytest.mark.parametrize("trunk", ["with", "without"])
def test_compiled_predictions_are_those_of_plain_python(trunk, tmp_path):
    """Numba takes the same source as the interpreter does: the plain path is the reference of the compiled one."""
    made = []
    for plain in ("0", "1"):
        path = tmp_path / f"{plain}.npy"
        environment = {**os.environ, "NUMBA_DISABLE_JIT": plain}
        subprocess.run([sys.executable, "-c", PREDICTIONS, str(path), trunk], env=environment, check=True)
        made.append(np.load(path))
    assert np.isfinite(made[0][:, :6]).all()
    np.testing.assert_allclose(made[0], made[1], rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("rows", [7, 14])
def test_a_step_solves_the_trapezoidal_rule_with_the_impulses_of_the_ground(rows):
    rng, m, h = np.random.default_rng(rows), 12, 0.005
    root = rng.standard_normal((m + 6, m + 6))
    M, K, D = root @ root.T + np.eye(m + 6), np.diag(rng.uniform(100, 900, m)), np.diag(rng.uniform(0.1, 2, m))
    C = np.zeros((14, m + 6))
    C[:7, m:], C[7:] = rng.standard_normal((7, 6)), rng.standard_normal((7, m + 6))
    y, w = rng.normal(0.0, 0.01, (2, m + 6))
    linear = Linear(
        y.copy(), K, D, rng.normal(0.0, 30.0, m + 6), C, np.zeros(14), np.full(1, 0.05), np.full(1, np.inf)
    )  # fmt: skip
    theta = rng.normal(0.0, 0.01, (2, m))
    solver, end = make_solver(M, K, D, C, h, rows), State(y.copy(), w.copy(), np.zeros(14))
    step_soles(end, linear, solver, *theta, 1, 0.7)
    assert end.P[:4].max() > 0.0 and end.P.min() > -np.inf and not end.P[rows:].any()
    mean = 0.5 * (w + end.w)
    moved = y + 0.5 * h * mean  # in the middle of the step
    pull = np.zeros(m + 6)
    pull[:m] = K @ (moved[:m] - theta.mean(axis=0)) + D @ (mean[:m] - (theta[1] - theta[0]) / h)
    np.testing.assert_allclose(M @ (end.w - w), h * (linear.f - pull) + C.T @ end.P, atol=1e-10)
    walked = np.delete(np.arange(m + 6), [m, m + 1, m + 5])
    np.testing.assert_allclose(end.y[walked], (y + h * mean)[walked], atol=1e-14)


def test_inertia_is_that_of_the_whole_body_by_the_coordinates():
    rng, m = np.random.default_rng(3), 12
    root, order = rng.standard_normal((20, 20)), np.array([8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19])
    S, tau = root @ root.T, rng.standard_normal(20)
    terms = terms_of(rng.standard_normal(terms_size(m)), m)
    project_dynamics(terms, np.triu(S), tau, 9.81, order)
    N = np.zeros((20, m + 6))  # velocities of the model by those of the coordinates
    N[:6, :6], N[:6, m:] = terms.geometry.V, terms.geometry.A
    N[order, np.arange(m)] = 1.0
    np.testing.assert_allclose(terms.M, N.T @ S @ N, atol=1e-10)
    np.testing.assert_allclose(terms.linear.f, N.T @ (S[:, :3] @ terms.geometry.down * 9.81 - tau), atol=1e-10)
