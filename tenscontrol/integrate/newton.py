"""Newton's iteration inside a CasADi graph: it stops by itself and says whether it converged."""

from __future__ import annotations

import casadi as ca

# Steps of Newton's iteration before it counts as failed.
_MOST = 12

# Converged when the last change moves nothing by more than this part of the size, or of the
# distance from the origin, whose round-off the lengths of strings have.
_SMALL = 1e-11

# Diverged when a change would move something by this many sizes.
_LARGE = 1e3


def newton_solver(system: ca.Function, size: float) -> ca.Function:
    """Return ``(y, x, u, h) -> (y, converged, iterations)``: the root from a first guess.

    Convergence is quadratic: where the last change was small, what is left is
    far smaller.

    Parameters
    ----------
    system : casadi.Function
        ``(y, x, u, h) -> (residual, jacobian)``; y are velocities over a step h.
    size : float
        Size of the structure, m, against which changes are measured.
    """
    iterate = _iteration(system)
    z = ca.MX.sym("z", iterate.size1_in(0))
    given = [ca.MX.sym(f"a{i}", system.size1_in(i)) for i in range(1, 4)]
    idle = ca.Function("idle", [z, *given], [z])
    choose = ca.Function.if_else("choose", iterate, idle)
    guess = ca.MX.sym("guess", system.size1_in(0))
    scale = size + ca.mmax(ca.fabs(given[0][: system.size1_in(1) // 2]))
    # Change made last, m, and number of iterations follow the unknowns.
    state = ca.vertcat(guess, scale, 0)
    for _ in range(_MOST):
        change = state[-2]
        # A change that is not a number is neither: the iteration ends, not converged.
        going_on = ca.logic_and(change > _SMALL * scale, change < _LARGE * scale)
        state = choose(going_on, state, *given)
    converged = state[-2] <= _SMALL * scale
    return ca.Function("newton", [guess, *given], [state[:-2], converged, state[-1]])


def _iteration(system: ca.Function) -> ca.Function:
    """Return ``(z, x, u, h) -> z``, one iteration on z = [y; change; iterations]."""
    z = ca.MX.sym("z", system.size1_in(0) + 2)
    x, u, h = (ca.MX.sym(f"a{i}", system.size1_in(i)) for i in range(1, 4))
    residual, jacobian = system(z[:-2], x, u, h)
    # No pivot is too small for light nodes: what is singular gives no finite change.
    change = ca.solve(jacobian, residual, "qr", {"eps": 0})
    # The norm, not the largest entry: CasADi's largest of numbers passes over what is none.
    new = ca.vertcat(z[:-2] - change, h * ca.norm_2(change), z[-1] + 1)
    return ca.Function("iteration", [z, x, u, h], [new])
