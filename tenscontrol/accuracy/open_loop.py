"""Motion in open loop on which integration methods are compared."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Function, builds
from tenscontrol.integrate.cvodes import is_expandable
from tenscontrol.simulation.scene import Scene
from tenscontrol.structure.bar_geometry import restore_bar_lengths


def open_loop_of(scene: object) -> Scene:
    """Return a scene in open loop, under inputs and loads that are held; see Scene.open_loop."""
    validation.instance(
        "scene", scene, Scene, "make one by Scene(model, duration, ...) or load_scene(file)"
    )
    assert isinstance(scene, Scene)  # checked just now
    scene = scene.open_loop()
    _ = scene.input_value, scene.load  # refuse what changes in time
    return scene


def state_change(case: Scene, moves: FloatArray) -> FloatArray:
    """Return the change of the state where nodes are moved, m, shape (d, n), and no bar stretches.

    Both shapes are restored: a bar off by round-off does not count as perturbed.
    """
    moved = restore_bar_lengths(case.structure, case.nodes + moves)
    change = moved - restore_bar_lengths(case.structure, case.nodes)
    return pack_state(case.structure, change, np.zeros_like(change))


# States up to which all eigenvalues are found; of more, only the six largest.
_DENSE = 600


@builds
def fastest_rate(case: Scene) -> float:
    """Return the largest magnitude of the eigenvalues of ∂f/∂x at the start, 1/s.

    All strings pull. Of an undamped structure that is its highest angular frequency ω; with ground
    that with all nodes on it, too; 1/duration at least.
    """
    equation = case.equation(derivatives=True)
    x, u, taut, _ = equation.symbols(ca.SX if is_expandable(equation) else ca.MX)
    jacobian = Function("jacobian", [x, u, taut], [ca.jacobian(equation.slope(x, u, taut), x)])
    pulls, rates = np.ones(equation.switches), [1 / case.duration]
    if equation.forces is not None and equation.contacts is not None:
        # Of nodes that stand still, however far above the ground: damping would say more there.
        n = equation.states // 2
        still = np.concatenate([case.state[:n], np.zeros(n)])
        stiffness = jacobian(still, case.input_value, pulls)[n:, :n]
        rates.append(float(np.sqrt(_largest_eigenvalue(stiffness))))
        contacts = slice(equation.forces.strings.switches, None)
        depth = equation.gap(case.state, case.input_value)[0].full()[contacts, 0]
        pulls[contacts] = depth > 0
    return max(_largest_eigenvalue(jacobian(case.state, case.input_value, pulls)), *rates)


def _largest_eigenvalue(matrix: ca.DM) -> float:
    """Return the largest magnitude of the eigenvalues of a square matrix."""
    if matrix.shape[0] <= _DENSE:
        eigenvalues = np.linalg.eigvals(matrix.full())
    else:
        from scipy.sparse.linalg import eigs

        eigenvalues = eigs(matrix.sparse().tocsc(), k=6, which="LM", return_eigenvectors=False)
    return float(np.abs(eigenvalues).max(initial=0.0))
