"""How far a shape is from buckling."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Model, kernel
from tenscontrol.statics import Prestress
from tenscontrol.structure import free_coordinates, with_supports
from tenscontrol.validation import FloatArray

# A string with less than this fraction of the largest γ is slack.
_SLACK = 1e-9


class Margin:
    """The stability margins of the shapes of a model.

    Parameters
    ----------
    model : Model
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        if model.strings is None:
            return
        structure = model.structure
        q = ca.SX.sym("q", len(structure.free_rows))
        lam = ca.SX.sym("lambda", len(structure.bars))
        rest_length = ca.SX.sym("rest_length", len(structure.strings))
        at = with_supports(structure, q)
        B = kernel.differences(at, structure.bars)
        squares = kernel.dots(B, B).T / 2
        stored = model.elastic_energy(ca.vertcat(q, ca.SX.zeros(q.numel())), rest_length)
        hessian, _ = ca.hessian(stored - ca.dot(lam, squares), q)
        results = [hessian, ca.jacobian(squares, q)]
        self._evaluate = ca.Function("stiffness", [q, rest_length, lam], results)

    def of(self, rest: Prestress, neutral: FloatArray) -> float:
        """Return the smallest eigenvalue of the stiffness at rest of what can move, N/m.

        With a string law: rest lengths held, bars rigid, motions as one body that
        nothing resists left out. Without: taut strings rigid as well, so that
        only the prestress stiffens, and infinite if there is no mechanism.

        Parameters
        ----------
        rest : Prestress
            The shape and its forces.
        neutral : ndarray, shape (3f, m)
            Displacements of the free nodes that nothing resists.
        """
        from scipy.linalg import null_space

        law = self._model.strings
        if law is None:
            return float(rest.stability.mechanism_stiffness.min(initial=np.inf))
        structure, gamma = rest.structure, rest.force_density
        wound = law.rest_length(structure.string_length(), gamma)
        # At the brink of slackness the stiffness has two values; the smaller one counts.
        wound = np.where(gamma > _SLACK * gamma.max(initial=0.0), wound, 2 * wound)
        place = free_coordinates(structure, structure.nodes)
        K, J = (
            np.array(part.full()) for part in self._evaluate(place, wound, rest.bar_force_density)
        )
        held = np.vstack([J, neutral.T])
        Z = null_space(held, rcond=1e-9) if held.size else np.eye(len(place))
        if Z.shape[1] == 0:
            return float("inf")
        return float(np.linalg.eigvalsh(Z.T @ K @ Z)[0])
