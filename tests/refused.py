"""Input that must be refused, and what the refusal must say: what the tables share.

A case is a call, the exception, and a regular expression for the message, which has to name the
argument (or the culprit) and what was found. Each folder has its table, ``test_..._input.py``.
Calls are functions of no argument, so that nothing runs before its own test.
"""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc

NAN, INF = float("nan"), float("inf")
STILL = np.zeros((3, 6))


def refused(name, call, exception, message):
    """One case of a table."""
    return pytest.param(call, exception, message, id=name)


def assert_refused(call, exception, message):
    """Call, and find the exception of the case."""
    with pytest.raises(exception, match=message) as raised:
        call()
    # A ValueError by inheritance only: nobody checked, and NumPy fell over.
    assert not isinstance(raised.value, np.linalg.LinAlgError)


# ---- good input, to be spoilt ----


def line(**changes):
    """A bar between two string nodes, with some arguments replaced."""
    arguments = {
        "nodes": [[0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]],
        "bars": [[1, 2]],
        "strings": [[0, 1], [2, 3]],
        "bar_mass": 1.0,
        "string_node_mass": 0.1,
    }
    return tc.Structure(**(arguments | changes))


def with_entry(array, index, value):
    """A copy of an array with one entry replaced."""
    changed = np.array(array, dtype=float)
    changed[index] = value
    return changed


@cache
def prism():
    return tc.prism()


def nodes():
    return prism().nodes


@cache
def rest():
    return tc.prestress(prism(), force_density=17.3205)


def gamma():
    return rest().force_density


@cache
def model():
    """Without string law."""
    return tc.Model(prism())


@cache
def elastic():
    """With string law."""
    return tc.Model(prism(), strings=tc.LinearStrings(stiffness=100.0))


@cache
def equation():
    """Of the prism with rest lengths held."""
    return elastic().equation("rest_length")


@cache
def loaded():
    """With a load input."""
    return tc.Model(prism(), external_force=True)


@cache
def plant(coordinates="internal"):
    return tc.linearize(model(), rest(), coordinates=coordinates)


@cache
def rest_length():
    return tc.to_rest_length(elastic(), nodes(), gamma()).rest_length


@cache
def regulator(step=0.001, max_force_density=50.0):
    return tc.LQR(plant(), Q=1.0, R=1e-3, sample_time=step, max_force_density=max_force_density)


@cache
def winch_regulator():
    """Commands rest lengths."""
    return tc.LQR(
        tc.linearize(elastic(), rest(), input="rest_length"), Q=1.0, R=1.0, sample_time=0.001
    )


@cache
def pentagon_regulator():
    """Commands fifteen strings."""
    pentagon = tc.prism(sides=5)
    return tc.LQR(tc.linearize(tc.Model(pentagon), tc.prestress(pentagon, 17.0)), Q=1.0, R=1.0)


@cache
def lone_bar():
    """A bar and no string."""
    return tc.Structure([[0, 1], [0, 0], [0, 0]], bars=[[0, 1]], strings=[], bar_mass=1.0)


@cache
def touching():
    """The model of a line whose second string has no length."""
    structure = line(nodes=[[0, 1, 2, 2], [0, 0, 0, 0], [0, 0, 0, 0]])
    return tc.Model(structure, strings=tc.LinearStrings(stiffness=100.0))


def drifting(of, nodes=None, force_density=None, **options):
    """The linear model of a shape that need not be at rest, of the prism if not given."""
    at = tc.OperatingPoint(prism().nodes if nodes is None else nodes, force_density)
    return tc.linearize(of, at, require_equilibrium=False, **options)


@cache
def held_plant():
    """Rest lengths are the input."""
    return tc.linearize(elastic(), rest(), input="rest_length")


@cache
def lengths(**options):
    """Sensors of all string lengths, with other options."""
    return tc.Sensors(**({"structure": prism(), "string_length": 1e-3} | options))


@cache
def estimator(step=0.001):
    return tc.KalmanFilter(held_plant(), lengths(), sample_time=step)


def run(**changes):
    """A short simulation with held rest lengths, with some arguments replaced."""
    return tc.simulate(
        **({"model": elastic(), "duration": 0.01, "rest_length": rest_length()} | changes)
    )


def closed(**changes):
    """A short simulation in closed loop, with some arguments replaced."""
    return tc.simulate(
        **({"model": elastic(), "duration": 0.002, "controller": regulator()} | changes)
    )
