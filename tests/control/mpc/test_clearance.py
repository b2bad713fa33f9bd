"""Bars kept apart by MPC and NMPC."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.structure.bar_clearance import bar_distances

SAMPLE = 0.02


@cache
def plant(held="force_density"):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(200.0, damping=0.3))
    return tc.linearize(model, tc.prestress(prism, 17.320508), input=held)


def test_rows_are_the_derivatives_of_the_distances():
    at = plant()
    rows = tc.clearance(at, 0.1).matrix
    rest = bar_distances(at.model.structure, at.nodes)
    np.testing.assert_allclose(rows @ at.nodes.ravel(order="F"), rest.distance, atol=1e-14)
    step = 1e-5
    for q in np.eye(9):
        after, before = (
            bar_distances(at.model.structure, at.to_nodes(sign * step * q)).distance
            for sign in (1, -1)
        )
        np.testing.assert_allclose((after - before) / (2 * step), rows @ at.basis @ q, atol=1e-8)


def test_distances_change_by_nothing_that_moves_all():
    """Moved or turned as one body, bars are as far apart as before."""
    at = plant()
    rows = tc.clearance(at, 0.1).matrix
    for axis in np.eye(3):
        np.testing.assert_allclose(rows @ np.tile(axis, 6), 0.0, atol=1e-14)
        turned = np.cross(axis, at.nodes.T).ravel()
        np.testing.assert_allclose(rows @ turned, 0.0, atol=1e-14)


@pytest.mark.parametrize(("kind", "held"), [(tc.MPC, "rest_length"), (tc.NMPC, "force_density")])
def test_bars_thrown_at_each_other_stay_apart(kind, held):
    at = plant(held)
    rest = bar_distances(at.model.structure, at.nodes).least
    closing = (tc.clearance(at, 0.1).matrix @ at.basis).sum(axis=0)
    thrown = at.to_velocities(np.zeros(9), -0.35 * closing / np.linalg.norm(closing))
    largest = 60.0 if held == "force_density" else None
    least = {}
    for name, outputs in (
        ("free", []),
        ("soft", [tc.clearance(at, 0.95 * rest, penalty=1e4)]),
    ):
        controller = kind(
            at, horizon=15, sample_time=SAMPLE, max_force_density=largest, outputs=outputs
        )
        run = tc.simulate(at.model, 0.8, at.nodes, thrown, controller=controller, step=2e-3)
        assert set(run.control.status) == {"ok"}
        least[name] = min(
            bar_distances(at.model.structure, N).least for N in np.moveaxis(run.nodes, 2, 0)
        )
    # What is limited is of first order in the motion, and predicted over samples.
    assert least["free"] < 0.91 * rest
    assert least["soft"] > 0.925 * rest


def test_bars_that_do_not_pass_one_another_are_refused():
    rails = tc.Structure(
        nodes=[[0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 0, 0]], bars=[[0, 1], [2, 3]],
        strings=[[0, 2], [1, 3]], bar_mass=1.0,
    )  # fmt: skip
    at = tc.linearize(
        tc.Model(rails), tc.OperatingPoint(rails.nodes, np.ones(2), np.zeros((3, 4))),
        require_equilibrium=False,
    )  # fmt: skip
    with pytest.raises(ValueError, match="no two bars that pass one another"):
        tc.clearance(at, 0.1)


@pytest.mark.parametrize(
    ("clearance", "penalty", "message"),
    [
        (0.3, None, r"clearance is 0\.3 m, but bars \d and \d are 0\.201\d+ m apart"),
        (0.0, None, r"clearance is 0\.0, expected a positive"),
        (np.nan, None, r"clearance is nan"),
        (0.1, -1.0, r"penalty is -1\.0"),
    ],
)
def test_bad_input(clearance, penalty, message):
    with pytest.raises(ValueError, match=message):
        tc.clearance(plant(), clearance, penalty)


def test_what_is_no_plant_is_refused():
    with pytest.raises(TypeError, match="plant is a Structure"):
        tc.clearance(replace(tc.prism()), 0.1)
