"""Derivatives of runs with driven bars: by central differences of tight runs, and adjoint."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc

NAMES = ["nodes", "velocities", "bar_length", "rest_length", "stiffness", "bar_mass"]
STEP = 1e-5
TIGHT = {"method": "dop853", "tolerance": 1e-12, "error": "none"}


def _given(structure, interpolation):
    """What a run depends on, and the run: bars are driven, strings switch."""
    rng = np.random.default_rng(3)
    grown = structure.bar_length[:, None] * (1 + 0.06 * rng.normal(size=(len(structure.bars), 4)))
    grown[:, 0] = structure.bar_length
    moving = np.zeros_like(structure.nodes)
    moving[:, structure.free] = 0.1 * rng.normal(size=(3, len(structure.free)))
    given = {
        "nodes": structure.nodes, "velocities": moving, "bar_length": grown,
        "rest_length": 0.99 * structure.string_length(), "bar_mass": structure.bar_mass,
        "stiffness": np.full(len(structure.strings), 300.0),
    }  # fmt: skip

    def run(**changed):
        made = given | changed
        model = tc.Model(
            replace(structure, bar_mass=made["bar_mass"]),
            tc.LinearStrings(made["stiffness"], damping=2.0),
        )
        lengths = tc.Profile(np.linspace(0.0, 0.2, 4), made["bar_length"], interpolation)
        return tc.simulate(
            model, 0.2, made["nodes"], made["velocities"], rest_length=made["rest_length"],
            bar_length=lengths, **TIGHT,
        )  # fmt: skip

    return given, run


# Bars begin at the rates of a profile with a jump, and stretch otherwise before; joined ones too.
KINDS = {
    "on supports": (replace(tc.prism(), fixed=[3, 4, 5]), "linear"),
    "free, smooth": (tc.prism(), "cubic"),
    "joined": (tc.library.d_bar_3d(), "linear"),
}


@pytest.fixture(scope="module")
def plant():
    """Three strings and two bars of a prism on fixed nodes are driven."""
    structure = replace(tc.prism(), fixed=[3, 4, 5])
    model = tc.Model(structure, tc.LinearStrings(300.0, damping=2.0))
    rest = tc.prestress(structure, min_force_density=20.0)
    return tc.linearize(model, rest, "length", actuated=["top"], struts=[0, 2])


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_differences_and_adjoint(kind):
    structure, interpolation = KINDS[kind]
    given, run = _given(structure, interpolation)
    rng, base = np.random.default_rng(1), run()
    names = NAMES
    tangent = tc.sensitivity(base, to=names)
    assert tangent.switches >= 3
    wanted = np.random.default_rng(2).normal(size=(2, *structure.nodes.shape))

    def cost(time, nodes, velocities):
        return ca.sumsqr(nodes - wanted[0]) + ca.dot(ca.DM(wanted[1]), velocities)

    slope = tc.gradient(base, cost, to=names).slope
    ends = base.nodes[..., -1:], base.velocities[..., -1:]
    by = 2 * (ends[0][..., 0] - wanted[0]), wanted[1]
    changes = {}
    for name in names:
        of = tangent.nodes[name][:, :, -1], tangent.velocities[name][:, :, -1]
        forward = sum(
            np.tensordot(weight, values, 2) for weight, values in zip(by, of, strict=True)
        )
        np.testing.assert_allclose(
            slope[name], forward, rtol=0, atol=1e-10 * max(np.abs(forward).max(), 1e-3)
        )
        changes[name] = rng.normal(size=given[name].shape) * np.abs(given[name]).max()
        if name in ("nodes", "velocities"):
            changes[name][:, structure.fixed] = 0.0
    for some in (names[:3], names[3:]):
        moved = [
            run(**{name: given[name] + k * STEP * changes[name] for name in some})
            for k in (1, -1, 2, -2)
        ]
        for array in ("nodes", "velocities"):
            a, b, c, d = (getattr(one, array)[..., -1] for one in moved)
            true = (8 * (a - b) - (c - d)) / (12 * STEP)
            found = sum(
                np.tensordot(
                    getattr(tangent, array)[name][:, :, -1], changes[name], changes[name].ndim
                )
                for name in some
            )
            np.testing.assert_allclose(found, true, rtol=0, atol=1e-7 * np.abs(true).max())


def test_commands_of_a_loop_are_held(plant):
    """As in a run in which strings and bars get the same ramps as profiles."""
    winches = tc.Winches(ramp=True, rate=1.0)
    law = tc.LQR(plant, sample_time=0.02, winches=winches)
    start = plant.to_nodes(0.01 * np.arange(1.0, 7.0))
    loop = tc.simulate(plant.model, 0.08, start, controller=law, winches=winches, **TIGHT)
    ends = np.column_stack([plant.string_values, loop.control.applied])
    wound, grown = (tc.Profile(np.linspace(0.0, 0.08, 5), rows) for rows in np.split(ends, [9]))
    alone = tc.simulate(plant.model, 0.08, start, rest_length=wound, bar_length=grown, **TIGHT)
    np.testing.assert_allclose(alone.nodes[..., -1], loop.nodes[..., -1], atol=1e-11)
    for name in ("nodes", "velocities", "bar_mass"):
        first, second = (tc.sensitivity(run, to=[name]) for run in (loop, alone))
        most = np.abs(second.velocities[name]).max()
        np.testing.assert_allclose(
            first.velocities[name], second.velocities[name], atol=1e-8 * most
        )
