"""The derivative of putting bars on their lengths, beside CasADi's of the projection itself."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.projection import projection
from tenscontrol.optimize.projection_slope import ProjectionSlope
from tests.random_structures import any_motion_of, any_structure

# By how much states are off, in sizes.
OFF = np.array([0.0, 1e-9, 1e-4, 2e-3])


def by_casadi(equation, x, u, directions):
    """Return the derivatives in directions of states, and of lengths and rates, at columns."""
    exact, layout = projection(equation), equation.layout
    states = ca.MX.sym("x", len(x))
    lengths, rates = (ca.MX.sym(name, layout.lengths) for name in ("lengths", "rates"))
    given = [states]
    if layout.lengths:
        others = ca.MX.zeros(layout.count - layout.lengths)
        given.append(ca.vertcat(others, lengths, others, rates, 0))
    end = exact(*given)
    whole = ca.vertcat(states, lengths, rates)
    slope = ca.jtimes(end, whole, ca.DM(directions))
    slope = ca.Function("slope", [states, lengths, rates], [ca.densify(slope)])
    held = u[:-1].reshape(2, layout.count, -1)[:, layout.length_rows]
    columns = zip(x.T, *held.swapaxes(1, 2), strict=True)
    return np.array([slope(*column).full() for column in columns])


@pytest.mark.parametrize("drives", [False, True], ids=["rigid", "driven"])
@pytest.mark.parametrize("seed", range(24))
def test_as_by_casadi(seed, drives):
    structure = any_structure(seed)
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    equation = model.equation("rest_length", degree=1, length_input=drives)
    random = np.random.default_rng(seed)
    moving = [of.ravel(order="F")[structure.free_rows] for of in any_motion_of(structure, seed)]
    x = np.tile(np.concatenate(moving)[:, None], (1, len(OFF)))
    x += OFF * structure.size * random.normal(size=x.shape)
    u = np.zeros((2 * equation.layout.count + 1, len(OFF)))
    if drives:
        values = u[:-1].reshape(2, equation.layout.count, len(OFF))
        shape = len(structure.bars), len(OFF)
        longer = 1 + 3e-3 * OFF / OFF.max() * random.normal(size=shape)
        values[0, equation.layout.length_rows] = structure.bar_length[:, None] * longer
        values[1, equation.layout.length_rows] = 0.1 * random.normal(size=shape)
    by_state, by_lengths = ProjectionSlope(equation)(x, u)
    assert (by_lengths is not None) == drives
    whole = by_state if by_lengths is None else np.concatenate([by_state, by_lengths], axis=2)
    directions = random.normal(size=(whole.shape[2], 3))  # all entries are in each product
    whole, exact = whole @ directions, by_casadi(equation, x, u, directions)
    is_near = np.isfinite(exact).all(axis=(1, 2))
    assert drives or is_near.all()
    assert (np.isfinite(whole).all(axis=(1, 2)) == is_near).all()
    sizes = np.abs(exact[is_near]).max()
    np.testing.assert_allclose(whole[is_near], exact[is_near], rtol=0, atol=1e-9 * sizes)
