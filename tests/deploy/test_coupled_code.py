"""Controllers of structures of class 2, in the plane, on rollers and with clusters, as C code."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tests.deploy import scenes

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")

# Samples with a number that is not finite, and with a bar twice as long.
SAMPLES, SPOILT, ABSURD = 60, (20, 21), (40,)


def lqr(plant):
    return tc.LQR(plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE, max_change=0.05)


def mpc(plant):
    winches = tc.Winches(rate=0.5, shortest=0.1)
    return tc.MPC(plant, horizon=3, sample_time=scenes.SAMPLE, winches=winches)


def nmpc(plant):
    winches = tc.Winches(rate=0.5, shortest=0.1)
    return tc.NMPC(plant, horizon=2, sample_time=scenes.SAMPLE, winches=winches)


@pytest.mark.parametrize(
    ("name", "make"),
    [("d_bar", lqr), ("d_bar", nmpc), ("arm", mpc), ("tower", mpc)],
)  # fmt: skip
def test_code_commands_what_python_does(name, make, tmp_path):
    at = scenes.coupled_plant(name)
    d, n = at.nodes.shape
    one = make(at)
    pair = scenes.Pair(one, tc.generate_c(one, tmp_path).compile(), SPOILT, ABSURD)
    rng, r = np.random.default_rng(2), at.degrees_of_freedom
    pair.applied(at.equilibrium_input)
    for k in range(SAMPLES):
        q, rates = 1e-3 * rng.normal(size=r), 2e-3 * rng.normal(size=r)
        nodes, velocities = at.to_nodes(q), at.to_velocities(q, rates)
        assert nodes.shape == (d, n)
        pair.applied(pair.command(k * scenes.SAMPLE, nodes, velocities).value)
    assert pair.statuses[0] == pair.statuses[1]
    assert pair.error < 1e-10
    found = [
        [k for k, status in enumerate(pair.statuses[1]) if f"measurement not {what}" in status]
        for what in ("finite", "plausible")
    ]
    assert found == [list(SPOILT), list(ABSURD)]
    assert pair.statuses[1].count("ok") > SAMPLES / 2


def test_a_node_off_its_roller_is_not_plausible(tmp_path):
    at = scenes.coupled_plant("arm")
    one = lqr(at)
    other = tc.generate_c(one, tmp_path).compile()
    for rise, what in ((1e-3, "ok"), (0.4, "measurement not plausible: equilibrium held")):
        nodes = at.nodes.copy()
        nodes[1, 2] += rise
        found = [each.command(0.0, nodes, 0 * nodes) for each in (one, other)]
        assert [str(each) for each in found] == [what] * 2
        np.testing.assert_allclose(*[each.value for each in found], rtol=1e-10)
        one.reset()
        other.reset()
