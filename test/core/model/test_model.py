# SPDX-License-Identifier: BSD-3-Clause
"""The paper's equation of motion: where each coefficient, share and effect acts, and what equilibrium says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robots import bent, config_of, robot_of

from coman_reduced_model.core.base.types import Foot, Phase, SupportState
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.model.cartesian import Model
from coman_reduced_model.errors import ConfigError

WEIGHT = 9.81 * robot_of("coman").mass
LEFT = SupportState(Phase.LEFT, Foot.LEFT, 1.0)
PAPER = Config().replaced({"model.trunk_rotation": "without"})
LATERAL = {"model.lateral_compliance": "with"}


def double(share=0.5, foot=Foot.LEFT):
    return SupportState(Phase.DOUBLE, foot, share)


def standing(knee=0.6, lean=0.05, roll=0.0, yaw=0.0):
    """A posture that leans a little, so that no coupling vanishes."""
    robot = robot_of("coman")
    q = bent(robot, knee, lean)
    for i, name in enumerate(robot.joint_names):
        if name[1:] in ("HipLat", "AnkLat"):
            q[i] = roll if name[1:] == "HipLat" else -roll
        if name[1:] == "HipYaw":
            q[i] = yaw if name[0] == "L" else -yaw
    posture = robot.posture()
    posture.update(q, np.zeros(12))
    return posture


def terms(changes=None, support=LEFT, landed=False, posture=None, offset=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)):
    """Terms with the posture's own COM as reference, moved by an offset."""
    posture = posture or standing()
    model = Model(robot_of("coman"), PAPER.replaced(changes or {}))
    foot = support.support_foot
    R, p = posture.sole_to_sole(foot, foot.other)
    other = R @ posture.com_in_sole(foot.other)[0] + p
    references = {
        foot: (posture.com_in_sole(foot)[0] + offset, np.array(velocity)),
        foot.other: (other + offset, np.array(velocity)),
    }
    return model.terms(posture, support, references, landed), references[foot][0]


def acceleration(terms, p, v=(0.0, 0.0, 0.0)):
    return np.linalg.solve(terms.M, terms.force - terms.K @ p - terms.D @ np.array(v))


@pytest.mark.parametrize("stiffness", ["full", "condensed"])
def test_single_support_is_the_leg_of_equations_12_and_13(stiffness):
    posture = standing(roll=0.1)
    found, p_r = terms({**LATERAL, "model.stiffness": stiffness}, posture=posture, velocity=(0.1, 0.2, 0.3))
    leg = config_of("coman").robot.left
    J, S = posture.leg_jacobian(Foot.LEFT), np.diag(1.0 / np.array(leg.stiffness))
    if stiffness == "full":
        J_inv = np.linalg.inv(J)
        K, D = (J_inv.T @ np.diag(diagonal) @ J_inv for diagonal in (leg.stiffness, leg.damping))
    else:
        K = np.linalg.inv(J[:3] @ S @ J[:3].T)
        D = K @ J[:3] @ S @ np.diag(leg.damping) @ S @ J[:3].T @ K
    K, D = K[:3, :3], D[:3, :3]
    scale = np.abs(K).max()
    np.testing.assert_allclose(found.K, K, atol=1e-4 * scale)
    np.testing.assert_allclose(found.D, D, atol=1e-4 * np.abs(D).max())
    force = found.K @ p_r + found.D @ [0.1, 0.2, 0.3] + [0, 0, -WEIGHT]
    np.testing.assert_allclose(found.force, force, atol=1e-9 * scale)
    np.testing.assert_array_equal(found.M, np.eye(3) * robot_of("coman").mass)
    assert found.axes.tolist() == [0, 1, 2]


# (20), (21): coefficient -> row (the force) and column (the deflection) of K or D that it multiplies.
COEFFICIENTS = {
    "a1": ("K", 0, 0), "b1": ("D", 0, 0), "c1": ("K", 0, 2), "e1": ("D", 0, 2),
    "a2": ("K", 2, 2), "b2": ("D", 2, 2), "c2": ("K", 2, 0), "e2": ("D", 2, 0),
}  # fmt: skip


@pytest.mark.parametrize("support", [LEFT, double()])
@pytest.mark.parametrize("name", COEFFICIENTS)
def test_each_coefficient_acts_where_equations_20_and_21_say(name, support):
    plain, _ = terms(support=support)
    tuned, p_r = terms({f"model.{name}": 3.0}, support=support, velocity=(0.1, 0.0, -0.2))
    matrix, row, column = COEFFICIENTS[name]
    for key in ("K", "D"):
        wanted = getattr(plain, key).copy()
        if key == matrix:
            assert abs(wanted[row, column]) > 1.0
            wanted[row, column] *= 3.0
        np.testing.assert_allclose(getattr(tuned, key), wanted, rtol=1e-12)
    # A COM that moves as its reference feels gravity alone.
    np.testing.assert_allclose(acceleration(tuned, p_r, (0.1, 0.0, -0.2)), [0, 0, -9.81], atol=1e-8)


def test_static_sag_is_m_g_over_k():
    found, p_r = terms(LATERAL)
    at_rest = np.linalg.solve(found.K, found.force)
    np.testing.assert_allclose(found.K @ (at_rest - p_r), [0, 0, -WEIGHT], atol=1e-8 * WEIGHT)
    plane, p_r = terms()
    x, z = p_r[[0, 2]] + np.linalg.solve(plane.K[np.ix_([0, 2], [0, 2])], [0, -WEIGHT])
    np.testing.assert_allclose(acceleration(plane, np.array([x, p_r[1], z]))[[0, 2]], 0.0, atol=1e-8)


def test_lateral_deflection_is_neither_integrated_nor_felt_unless_wanted():
    """(20), (21) have no y: where the reference stands sideways must not push in x and z."""
    posture = standing(roll=0.15)
    here, p_r = terms(posture=posture)
    assert here.axes.tolist() == [0, 2]
    aside, _ = terms(posture=posture, offset=(0.0, 0.05, 0.0), velocity=(0.0, 0.3, 0.0))
    for p in (p_r, p_r + [0.0, 0.01, 0.0]):
        np.testing.assert_allclose(acceleration(aside, p)[[0, 2]], acceleration(here, p)[[0, 2]], atol=1e-9)
    in_3d, _ = terms(LATERAL, posture=posture, offset=(0.0, 0.05, 0.0))
    assert in_3d.axes.tolist() == [0, 1, 2]
    assert np.abs(acceleration(in_3d, p_r)[[0, 2]] - [0.0, -9.81]).min() > 0.01
    assert acceleration(in_3d, p_r)[1] > 1.0


SHARES = {"x_before": 0.3, "x_after": 0.5, "z_before": 0.4, "z_after": 0.8}


@pytest.mark.parametrize("foot", [Foot.LEFT, Foot.RIGHT])
@pytest.mark.parametrize("landed", [True, False])
def test_constant_shares_divide_the_force_of_the_support_leg(landed, foot):
    """(22), (23): `before` its single support the leg has just landed, `after` it stands behind."""
    single = SupportState(Phase(foot), foot, 1.0 if foot == Foot.LEFT else 0.0)
    changes = {f"model.share_{key}": value for key, value in SHARES.items()}
    alone, p_r = terms(changes, support=single)
    found, _ = terms(changes, support=double(0.9, foot), landed=landed)
    moment = "before" if landed else "after"
    x, z = SHARES[f"x_{moment}"], SHARES[f"z_{moment}"]
    for key in ("K", "D"):
        np.testing.assert_allclose(getattr(found, key)[0], getattr(alone, key)[0] / x, rtol=1e-12)
        np.testing.assert_allclose(getattr(found, key)[2], getattr(alone, key)[2] / z, rtol=1e-12)
    np.testing.assert_allclose(acceleration(found, p_r), [0, 0, -9.81], atol=1e-8)  # gravity is not divided


def test_the_papers_shares_are_the_default():
    alone, _ = terms()
    for landed, share in ((True, 0.42), (False, 0.58)):
        found, _ = terms(support=double(), landed=landed)
        np.testing.assert_allclose(found.K[2], alone.K[2] / share, rtol=1e-12)


@pytest.mark.parametrize(
    ("left_share", "foot", "divisor"),
    [(0.7, Foot.LEFT, 0.7), (0.7, Foot.RIGHT, 0.3), (0.0, Foot.LEFT, 0.05), (float("nan"), Foot.LEFT, 0.5)],
)
def test_measured_shares(left_share, foot, divisor):
    """Sample by sample; bounded where the leg is hardly loaded, half where a wrench is stale."""
    single = SupportState(Phase(foot), foot, 0.5)
    alone, _ = terms(support=single)
    found, _ = terms({"model.shares": "measured"}, support=double(left_share, foot))
    for key in ("K", "D"):
        np.testing.assert_allclose(getattr(found, key), getattr(alone, key) / divisor, rtol=1e-12)


def test_both_legs_act_in_parallel():
    posture = standing(roll=0.1, yaw=0.3)  # told in the axes of one sole, though they point apart
    changes = {**LATERAL, "model.double_support": "both_legs"}
    found, p_r = terms(changes, support=double(0.6), posture=posture, velocity=(0.1, 0.2, 0.3))
    model = Model(robot_of("coman"), PAPER.replaced(changes))
    (K_l, D_l, _, _), (K_r, D_r, _, _) = (
        model.leg_stiffness(posture, foot, WEIGHT) for foot in (Foot.LEFT, Foot.RIGHT)
    )
    R, _ = posture.sole_to_sole(Foot.LEFT, Foot.RIGHT)
    np.testing.assert_allclose(found.K, K_l[:3, :3] + R @ K_r[:3, :3] @ R.T, rtol=1e-9)
    np.testing.assert_allclose(found.D, D_l[:3, :3] + R @ D_r[:3, :3] @ R.T, rtol=1e-9)
    np.testing.assert_allclose(acceleration(found, p_r, (0.1, 0.2, 0.3)), [0, 0, -9.81], atol=1e-8)


def test_two_legs_alike_are_twice_one_leg_whichever_supports():
    posture = standing()  # symmetric
    alone, _ = terms(posture=posture)
    for foot in (Foot.LEFT, Foot.RIGHT):
        found, _ = terms({"model.double_support": "both_legs"}, support=double(0.5, foot), posture=posture)
        xz = np.ix_([0, 2], [0, 2])
        np.testing.assert_allclose(found.K[xz], 2.0 * alone.K[xz], rtol=1e-9)
        np.testing.assert_allclose(found.D[xz], 2.0 * alone.D[xz], rtol=1e-9)


def test_legs_that_disagree_meet_in_the_middle():
    """Each leg pulls towards its own reference."""
    posture = standing()
    model = Model(robot_of("coman"), PAPER.replaced({"model.double_support": "both_legs"}))
    p, still = posture.com_in_sole(Foot.LEFT)[0], np.zeros(3)
    references = {Foot.LEFT: (p + [0.01, 0, 0.004], still), Foot.RIGHT: (p - [0.01, 0, 0.004], still)}
    found = model.terms(posture, double(), references, False)
    np.testing.assert_allclose(acceleration(found, p), [0.0, 0.0, -9.81], atol=1e-7)


def soft_ankle(ankle, **changes):
    """All joints rigid but the ankle pitch: an inverted pendulum about the ankle."""
    springs = [1e7] * 4 + [ankle, 1e7]
    values = {f"robot.{side}.stiffness": springs for side in ("left", "right")}
    return {**values, "model.stiffness": "condensed", "model.singular_limit": 1e-6, **changes}


def test_gravity_softens_horizontally_like_a_toppling_pendulum():
    """(k - m g h) / h^2 instead of k / h^2: m g / h less, h the COM above the ankle."""
    posture = standing(knee=0.6, lean=0.0)
    without, p_r = terms(soft_ankle(500.0), posture=posture)
    with_gravity, _ = terms(soft_ankle(500.0, **{"model.gravity_stiffness": "with"}), posture=posture)
    J = posture.leg_jacobian(Foot.LEFT)
    h = abs(J[0, 4])
    assert 0.2 < h < p_r[2]
    # Seen from the ankle the COM moves on a circle: what counts is the compliance of the x direction.
    k, k_g = (1.0 / np.linalg.inv(t.K[np.ix_([0, 2], [0, 2])])[0, 0] for t in (without, with_gravity))
    assert k == pytest.approx(500.0 / h**2, rel=0.01)
    assert k - k_g == pytest.approx(WEIGHT / h, rel=0.01)


def test_gravity_counts_with_the_weight_on_the_leg():
    """In `both_legs` each leg carries its share: half the softening each, the same altogether."""
    posture = standing(lean=0.0)
    gravity = {"model.gravity_stiffness": "with", "model.double_support": "both_legs"}
    softening = []
    for share in (0.5, 0.8):
        plain, _ = terms(soft_ankle(2000.0, **{"model.double_support": "both_legs"}), double(share), posture=posture)
        soft, _ = terms(soft_ankle(2000.0, **gravity), double(share), posture=posture)
        k, k_g = (1.0 / np.linalg.inv(t.K[np.ix_([0, 2], [0, 2])])[0, 0] for t in (plain, soft))
        softening.append(k - k_g)
    h = abs(posture.leg_jacobian(Foot.LEFT)[0, 4])
    np.testing.assert_allclose(softening, WEIGHT / h, rtol=0.02)


def test_a_near_singular_leg_is_told():
    assert not terms(posture=standing(0.6))[0].near_singular
    assert terms(posture=standing(0.0, 0.0))[0].near_singular
    assert terms({"model.double_support": "both_legs"}, double(), posture=standing(0.0, 0.0))[0].near_singular


def test_pendulum_is_the_lipm():
    model = Model(robot_of("coman"), PAPER)
    zmp, p = np.array([0.02, -0.01, 0.0]), np.array([0.05, 0.03, 0.4])
    found = model.pendulum(0.4, zmp)
    np.testing.assert_allclose(acceleration(found, p)[:2], 9.81 / 0.4 * (p - zmp)[:2], rtol=1e-12)
    assert found.axes.tolist() == [0, 1]


def test_assembling_changes_nothing_that_stays():
    """Effects work on copies: a second call finds what the first one found."""
    posture = standing()
    active = {"model.gravity_stiffness": "with", "model.lateral_compliance": "with"}
    model = Model(robot_of("coman"), PAPER.replaced(active))
    references = {Foot.LEFT: posture.com_in_sole(Foot.LEFT)}
    first, second = (model.terms(posture, LEFT, references, False) for _ in range(2))
    for key in ("M", "K", "D", "force"):
        np.testing.assert_array_equal(getattr(first, key), getattr(second, key))


def test_an_effect_at_a_joint_that_the_legs_lack_is_refused(monkeypatch):
    from coman_reduced_model.core.effects.base import EffectConfig
    from coman_reduced_model.core.effects.catalogue import CATALOGUE, Effect, build_effects

    class AtJoint(Effect):
        name, place = "at_joint", "joint"

    monkeypatch.setitem(CATALOGUE, "at_joint", AtJoint)
    for where, fits in (("LKneeSag", True), ("Knee", False)):
        config = Config(effects=(EffectConfig("at_joint", where),))
        if fits:
            build_effects(config.effects, robot_of("coman"))
            continue
        with pytest.raises(ConfigError, match=r"effects.at_joint.where: no leg joint 'Knee'.*LKneeSag"):
            build_effects(config.effects, robot_of("coman"))


@pytest.mark.parametrize("stiffness", ["full", "condensed"])
def test_springs_told_by_their_tangent_hold_as_the_law_does(monkeypatch, stiffness):
    """A hardening knee: the force of all springs at the COM that belongs to a deflection of the joints, as J^-T tau."""
    from coman_reduced_model.core.effects.base import EffectConfig
    from coman_reduced_model.core.effects.catalogue import CATALOGUE, Effect, build_effects
    from coman_reduced_model.core.effects.hooks import LegSprings

    deflection = np.array([1e-3, 1e-3, 1e-3, 0.08, 0.05, 1e-3])
    cubic = 40.0

    class Hardening(Effect):
        name = "hardening"

        def springs(self, leg: LegSprings) -> None:
            k, d = leg.K_q[3, 3], leg.deflection[3]
            leg.K_q[3, 3] = k * (1.0 + 3.0 * cubic * d**2)
            leg.torque[3] = k * d * (1.0 + cubic * d**2) - leg.K_q[3, 3] * d

    monkeypatch.setitem(CATALOGUE, "hardening", Hardening)
    config = replace(PAPER.replaced({"model.stiffness": stiffness}), effects=(EffectConfig("hardening"),))
    robot, posture = robot_of("coman"), standing()
    model, J = Model(robot, config, build_effects(config.effects, robot)[0]), posture.leg_jacobian(Foot.LEFT)
    stiff = np.array(config.robot.left.stiffness)
    tau = stiff * deflection
    tau[3] *= 1.0 + cubic * deflection[3] ** 2
    K, _, bias, _ = model.leg_stiffness(posture, Foot.LEFT, WEIGHT, deflection)
    if stiffness == "full":  # no turn of the trunk: what holds the COM there is not tau, but differs from it by K_c w
        moved = deflection - np.linalg.solve(J, np.concatenate((np.zeros(3), J[3:] @ deflection)))
        moved_tau = tau.copy()
        slope = stiff.copy()
        slope[3] *= 1.0 + 3.0 * cubic * deflection[3] ** 2
        moved_tau += slope * (moved - deflection)
        np.testing.assert_allclose(
            K @ (J[:3] @ moved) - bias, np.linalg.solve(J.T, moved_tau)[:3], atol=2e-3 * np.abs(K).max() * 0.01
        )
    else:  # a force alone at the COM: tau = J^T F
        force = np.array([30.0, 0.0, -150.0])
        slope = stiff.copy()
        slope[3] *= 1.0 + 3.0 * cubic * deflection[3] ** 2
        d = deflection + (J[:3].T @ force - tau) / slope
        np.testing.assert_allclose(K @ (J[:3] @ d) - bias, force, atol=0.05)
