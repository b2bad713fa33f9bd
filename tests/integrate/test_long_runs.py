"""A million steps: bar lengths and energy."""

import pytest

import tenscontrol as tc
from tests.dynamics.scenes import paper_force_density, rest_lengths


@pytest.fixture(scope="module")
def example():
    """The paper's example 1: strings go slack and taut about twenty times a second."""
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    return tc.Case(model, 1.0, input="rest_length", value=lengths)


def test_a_million_steps_of_rattle_keep_bar_lengths_and_energy(example):
    run = tc.long_run(example, "rattle", 5e-3, 1_000_000, machine_code=True)
    assert run.failure == ""
    assert run.work.steps >= 1_000_000
    assert run.work.switches > 50_000
    assert run.of("bar length").largest < 1e-13
    assert run.of("energy").largest < 0.05 * run.energy_scale
    assert run.of("energy").is_zero


def test_rk4_loses_energy_beside_it(example):
    run = tc.long_run(example, "rk4", 5e-3, 20_000, machine_code=True)
    assert not run.of("energy").is_zero
    assert run.of("energy").slope < 0
    assert run.of("bar length").largest > 1e-6
