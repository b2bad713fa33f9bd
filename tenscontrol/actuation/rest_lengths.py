"""Rest lengths that give force densities in a shape at rest."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import ArrayRecord, FloatArray, IntArray, frozen
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.bar_geometry import refuse_strings_without_length


@dataclass(frozen=True, eq=False)
class RestLengths(ArrayRecord):
    """Rest lengths that give wanted force densities. Made by :func:`to_rest_length`.

    They can be given wherever their array can: to :func:`simulate`, :func:`linearize`, and so on.

    Attributes
    ----------
    rest_length : ndarray, shape (α,)
        m. Just the current length where γ = 0 is wanted.
    slack : ndarray of int
        Strings with γ = 0: any longer rest length would do as well.
    """

    rest_length: FloatArray
    slack: IntArray

    stands_for = MappingProxyType({"rest_length": "rest_length"})

    def __repr__(self) -> str:
        some = (
            f"{self.rest_length.min(initial=np.inf):.4g} to {self.rest_length.max(initial=0):.4g} m"
        )
        slack = f", {len(self.slack)} slack" if len(self.slack) else ""
        return f"RestLengths({len(self.rest_length)} strings, {some}{slack})"


def to_rest_length(model: Model, nodes: object, force_density: object = None) -> RestLengths:
    """Return the rest lengths that give the strings these force densities in a given shape.

    Parameters
    ----------
    model : Model
        With a string law.
    nodes : array_like, shape (d, n)
        Current node positions, m; or a :class:`Prestress`, for its nodes and, if no other are
        given, its force densities.
    force_density : float or array_like, shape (α,)
        Wanted γ, N/m, at least 0.

    Returns
    -------
    RestLengths

    Raises
    ------
    TypeError, ValueError
        If the model has no string law, an argument does not fit, or a string is too soft for its γ.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> found = tc.to_rest_length(model, rest)
    >>> found.rest_length[[0, 6]].round(4), found.slack
    (array([0.7794, 0.854 ]), array([], dtype=int64))
    >>> tc.to_force_density(model, prism.nodes, found)[[0, 6]].round(4)
    array([10.    , 17.3205])
    """
    if force_density is None and isinstance(nodes, Prestress):
        force_density = nodes.force_density
    force_density = validation.array_of("force_density", force_density)
    law, length = _law_and_length(model, nodes)
    rest_length = law.rest_length(length, force_density)
    wanted = np.broadcast_to(np.asarray(force_density, dtype=float), length.shape)
    return RestLengths(frozen(rest_length), frozen(np.flatnonzero(wanted == 0)))


def to_force_density(model: Model, nodes: object, rest_length: object) -> FloatArray:
    """Return the force densities of strings from their rest lengths, in a given shape at rest.

    Parameters
    ----------
    model : Model
        With a string law.
    nodes : array_like, shape (d, n)
        Current node positions, m.
    rest_length : float or array_like, shape (α,)
        m, positive.

    Returns
    -------
    ndarray, shape (α,)
        γ, N/m; 0 for a slack string.

    Raises
    ------
    TypeError, ValueError
        If the model has no string law or an argument does not fit.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> tc.to_force_density(model, prism.nodes, rest_length=0.7)[[0, 6]].round(3)
    array([19.171, 32.233])
    """
    law, length = _law_and_length(model, nodes)
    return law.force_density(length, rest_length)


def _law_and_length(model: Model, nodes: object) -> tuple[StringLaw, FloatArray]:
    """Return the string law, and the string lengths in a shape, m."""
    validation.instance("model", model, Model, "make one by Model(structure, strings=...)")
    if model.strings is None:
        raise ValueError(
            "the model has no string law, so rest lengths have no meaning for it; "
            "build it as Model(structure, strings=LinearStrings(stiffness=...))"
        )
    shape = model.structure.checked_nodes("nodes", nodes)
    refuse_strings_without_length("nodes", model.structure, shape)
    return model.strings, model.structure.string_length(shape)
