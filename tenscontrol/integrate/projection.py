"""Bar lengths made exact after a step that does not keep them."""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.dynamics.kernel import dots, scale_columns
from tenscontrol.integrate.bodies import Bodies
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray


def project(structure: Structure, symbol: Any = ca.SX.sym) -> ca.Function:
    """Return ``(x) -> x``: the state near by whose bars have their lengths and do not stretch.

    Bar by bar and in closed form: the bar vector is scaled to its length, the
    nearest state in the metric of the mass; what its rate has along the bar is
    removed, and the rest is scaled by the inverse, so that ``b × ḃ`` stays.
    Centres, string nodes and hinges stay, and linear and angular momentum with
    them, to round-off.

    Parameters
    ----------
    structure : Structure
    symbol : callable, optional
        ``casadi.SX.sym``, or ``casadi.MX.sym`` for large structures.

    Returns
    -------
    casadi.Function

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.integrate.projection import project
    >>> prism = tc.prism()
    >>> stretched = np.concatenate([1.01 * prism.nodes.ravel(order="F"), np.zeros(18)])
    >>> x = np.array(project(prism)(stretched)).ravel()
    >>> nodes = x[:18].reshape(3, 6, order="F")
    >>> bool(np.allclose(np.linalg.norm(prism.bar_vectors(nodes), axis=0), prism.bar_length))
    True
    """
    bodies = Bodies(structure)
    count = len(structure.free)
    x = symbol("x", 6 * count)
    nodes, velocities = (ca.reshape(part, 3, count) for part in (x[: 3 * count], x[3 * count :]))
    points, B = bodies.split(nodes, bodies.hinges)
    point_rates, Bd = bodies.split(velocities)
    square = dots(B, B)
    scale = bodies.length / ca.sqrt(square)
    across = Bd - scale_columns(B, dots(B, Bd) / square)
    moved = bodies.join(points, scale_columns(B, scale), bodies.hinges)
    rates = bodies.join(point_rates, scale_columns(across, 1 / scale))
    return ca.Function("project", [x], [ca.vertcat(ca.vec(moved), ca.vec(rates))])


def projection(equation: Equation) -> ca.Function | None:
    """Return :func:`project` for an equation, or None where there are no bars."""
    if equation.structure is None or len(equation.structure.bars) == 0:
        return None
    return project(equation.structure, equation.symbol)


class Projector:
    """Makes the bar lengths of many states exact.

    Parameters
    ----------
    equation : Equation
    wanted : bool
        Whether to do so; else, and where there are no bars, states stay as they are.
    """

    def __init__(self, equation: Equation, wanted: bool) -> None:
        self._exact = projection(equation) if wanted else None
        # By the number of states: a span is followed by others like it.
        self._columns: dict[int, Evaluator] = {}

    def __call__(self, states: FloatArray) -> FloatArray:
        """Return states, one a column."""
        count = states.shape[1]
        if self._exact is None or count == 0:
            return states
        if count not in self._columns:
            self._columns[count] = Evaluator(self._exact.map(count))
        given = states if count > 1 else states[:, 0]
        return self._columns[count](given)[0].reshape(-1, count, order="F").copy()


def projected(step: ca.Function, equation: Equation) -> ca.Function:
    """Return a step that is followed by :func:`project`.

    Parameters
    ----------
    step : casadi.Function
        ``(x, u, taut, h) -> x1``.
    equation : Equation
        That of the step.

    Returns
    -------
    casadi.Function
        ``(x, u, taut, h) -> x1``; the step itself where there are no bars.
    """
    exact = projection(equation)
    if exact is None:
        return step
    symbols = ca.SX if step.is_a("SXFunction") else ca.MX
    arguments = [symbols.sym(step.name_in(i), step.size1_in(i)) for i in range(step.n_in())]
    return ca.Function(f"projected_{step.name()}", arguments, [exact(step(*arguments))])
