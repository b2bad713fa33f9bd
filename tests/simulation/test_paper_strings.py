"""Example 1 of the paper: the prism with strings of four segments, against the oracle.

"All string members are given stiffness values of 100 N/m" leaves open whether a member is a string
or a segment. Both readings are here:

- ``whole``: a string has 100 N/m, so that each of its segments has 400 N/m, and γ is that of the
  string: a segment has 4 γ;
- ``literal``: each segment has 100 N/m and γ as written.

Strings go slack and taut from 0.08 s on. A difference of 1e-10 m grows to 2e-9 m in 1 s and to
2e-7 m in 5 s (measured below), so codes are compared over 1 s; over 5 s only invariants, and what
is exact.
"""

from types import SimpleNamespace

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength

SEGMENTS, NODE_MASS, STIFFNESS = 4, 0.01, 100.0
READINGS = ("whole", "literal")


def scene(reading):
    """The prism with strings cut, its model, and rest lengths that give the paper's γ."""
    structure = tc.subdivide(tc.prism(), SEGMENTS, node_mass=NODE_MASS)
    gamma = paper_force_density(9.0)
    if reading == "whole":
        stiffness = STIFFNESS * tc.structure.segment_counts(structure)
        gamma = tc.structure.spread_force_density(structure, gamma)
    else:
        stiffness = np.full(len(structure.strings), STIFFNESS)
        gamma = gamma[structure.string_parent]
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness))
    return model, rest_lengths(structure, gamma, stiffness)


@pytest.fixture(scope="module")
def exact():
    """Both readings by the oracle over 1 s, every millisecond."""
    time, found = np.linspace(0, 1, 1001), {}
    for reading in READINGS:
        model, lengths = scene(reading)
        law = HeldRestLength(lengths, model.strings.stiffness)
        nodes, switches = exact_motion(model.structure, law, time)
        found[reading] = SimpleNamespace(nodes=nodes, switches=switches)
    return found


@pytest.mark.parametrize(("reading", "first"), [("whole", 0.0813), ("literal", 0.1627)])
def test_both_readings_follow_the_oracle(exact, reading, first):
    """Over 1 s; measured 2.4e-12 and 5.1e-12 m, with 14 and 4 switches on the way."""
    model, lengths = scene(reading)
    run = tc.simulate(model, 1.0, rest_length=lengths, tolerance=1e-12, output_step=0.01)
    assert np.abs(run.nodes - exact[reading].nodes[:, :, ::10]).max() < 1e-11
    assert exact[reading].switches[0] == pytest.approx(first, abs=1e-4)


def test_fixed_steps_follow_the_oracle_too(exact):
    """As a user would run it: 0.25 ms; the switches leave 5e-7 m."""
    model, lengths = scene("whole")
    run = tc.simulate(model, 1.0, rest_length=lengths, step=2.5e-4, output_step=1e-3)
    assert np.abs(run.nodes - exact["whole"].nodes).max() < 1e-6


# ---- one reading is the other at half speed ----


def test_the_readings_have_the_same_rest_lengths_and_a_quarter_of_the_forces():
    (whole, lengths), (literal, same) = scene("whole"), scene("literal")
    np.testing.assert_array_equal(lengths, same)
    shape = whole.structure.nodes
    forces = [tc.to_force_density(model, shape, lengths) for model in (whole, literal)]
    np.testing.assert_array_equal(forces[0], 4 * forces[1])


def test_the_literal_reading_is_the_other_at_half_speed_bit_by_bit():
    """A quarter of all forces and the same masses: time counts double, speeds half.

    With the step doubled as well, every operation of the one run is that of the other times a
    power of two, which rounds alike. So it holds however the motion magnifies errors.
    """
    (whole, lengths), (literal, _) = scene("whole"), scene("literal")
    fast = tc.simulate(whole, 2.0, rest_length=lengths, step=5e-4, output_step=0.01)
    slow = tc.simulate(literal, 4.0, rest_length=lengths, step=1e-3, output_step=0.02)
    np.testing.assert_array_equal(slow.time, 2 * fast.time)
    np.testing.assert_array_equal(slow.nodes, fast.nodes)
    np.testing.assert_array_equal(2 * slow.velocities, fast.velocities)
    assert np.abs(fast.velocities).max() > 1.0


def test_the_oracle_sees_half_the_speed_too(exact):
    """The steps of the oracle are its own; measured 3.4e-13 m."""
    slow, fast = exact["literal"], exact["whole"]
    np.testing.assert_allclose(slow.nodes[:, :, ::2], fast.nodes[:, :, :501], rtol=0, atol=1e-12)
    np.testing.assert_allclose(slow.switches[0], 2 * fast.switches[0], rtol=1e-9)


def test_adaptive_steps_see_half_the_speed_too():
    """Over 2 s of the slow one; measured 4e-12 m."""
    (whole, lengths), (literal, _) = scene("whole"), scene("literal")
    options = {"rest_length": lengths, "tolerance": 1e-12}
    fast = tc.simulate(whole, 1.0, output_step=0.01, **options)
    slow = tc.simulate(literal, 2.0, output_step=0.02, **options)
    assert np.abs(slow.nodes - fast.nodes).max() < 1e-11


# ---- what the mass of the strings does ----


def test_string_mass_changes_the_motion_of_the_first_node(exact, paper_motion):
    """Figure 3: strings of 0.27 kg on bars of 3 kg move node 0 by 73 mm in z, of a range of 82.

    Both motions by the oracle, over 1 s. The paper counts nodes from 1.
    """
    massless, massive = paper_motion.nodes[2, 0, :1001], exact["whole"].nodes[2, 0]
    assert np.abs(massive - massless).max() == pytest.approx(0.0729, abs=1e-4)
    assert np.ptp(massless) == pytest.approx(0.0819, abs=1e-4)
    assert np.ptp(massive) == pytest.approx(0.0724, abs=1e-4)


def test_lighter_strings_change_it_less(paper_motion):
    """Over 1 s: 31.3 mm with beads of 1 g, 27 g of string on 3 kg of bars."""
    structure = tc.subdivide(tc.prism(), SEGMENTS, node_mass=1e-3)
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS * SEGMENTS))
    lengths = tc.structure.spread_rest_length(structure, paper_motion.rest_length)
    run = tc.simulate(model, 1.0, rest_length=lengths, tolerance=1e-9, output_step=1e-3)
    off = np.abs(run.nodes[2, 0] - paper_motion.nodes[2, 0, :1001]).max()
    assert off == pytest.approx(0.0313, abs=1e-4)


# ---- what can be said over 5 s ----


def test_invariants_hold_over_five_seconds():
    """Measured: energy to 1.1e-8 of itself, momenta at round-off, bars to 4e-12 m."""
    model, lengths = scene("whole")
    run = tc.simulate(model, 5.0, rest_length=lengths, tolerance=1e-9, output_step=1e-2)
    # Σ ½ k (l - l0)² = Σ ½ (γ l)²/k at the start
    whole = tc.prism().string_length() * paper_force_density(9.0)
    assert run.energy[0] == pytest.approx(0.5 * (whole**2).sum() / STIFFNESS, rel=1e-12)
    assert np.ptp(run.energy) < 3e-8 * run.energy[0]
    assert max(np.abs(run.momentum).max(), np.abs(run.angular_momentum).max()) < 1e-12
    assert np.abs(run.bar_length_error).max() < 1e-11


def test_a_small_difference_grows_slowly_enough_for_the_comparison():
    """1e-10 m at the string nodes becomes 2e-9 m in 1 s, and 2e-7 m in 5 s."""
    model, lengths = scene("whole")
    structure = model.structure
    nudged = structure.nodes.copy()
    nudged[:, structure.string_nodes] += 1e-10 * np.random.default_rng(0).normal(size=(3, 27))
    options = {"rest_length": lengths, "tolerance": 1e-11, "output_step": 1.0}
    runs = [tc.simulate(model, 5.0, start, **options) for start in (structure.nodes, nudged)]
    growth = np.abs(runs[1].nodes - runs[0].nodes).max(axis=(0, 1))
    assert growth[1] < 4e-9
    assert 2e-8 < growth[5] < 2e-6
