"""What a shape is asked for: places of nodes and points, a height, a twist."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import casadi as ca
import numpy as np

from tenscontrol.shape.checks import (
    axis_rows,
    checked_tolerance,
    node_list,
    refuse_bad_directions,
    refuse_missing,
)
from tenscontrol.structure import Structure
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    frozen,
    shaped,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


class Demand(ABC):
    """One thing that a shape is asked for. A tolerance of 0 asks for it exactly."""

    tolerance: float

    @property
    @abstractmethod
    def unit(self) -> str:
        """``"m"`` or ``"rad"``."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """A name for each number that is asked for."""

    @property
    @abstractmethod
    def wanted(self) -> FloatArray:
        """The numbers asked for, shape (k,)."""

    @abstractmethod
    def miss(self, N: Any) -> Any:
        """Return by how much the numbers differ from those asked for.

        Parameters
        ----------
        N : casadi.SX, shape (3, n)
            Node positions, m.
        """

    @abstractmethod
    def refuse_other_nodes(self, name: str, structure: Structure) -> None:
        """Raise if a node that is named is not one of the structure.

        Parameters
        ----------
        name : str
            What the message calls the demand.
        structure : Structure
        """


@final
@dataclass(frozen=True, eq=False)
class NodesAt(Demand):
    """Nodes at given places.

    Parameters
    ----------
    nodes : sequence of int, length k
        The nodes.
    positions : array_like, shape (d, k)
        Where they are to be, m: a row for each of the directions.
    directions : str
        Which coordinates are asked for: letters out of ``"xyz"``.
    tolerance : float
        How far off each coordinate may be, m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    The bottom of a prism on the ground, wherever it stands there:

    >>> import tenscontrol as tc
    >>> tc.NodesAt([3, 4, 5], [[0, 0, 0]], directions="z").names
    ('z[3]', 'z[4]', 'z[5]')
    """

    nodes: IntArray
    positions: FloatArray
    directions: str = "xyz"
    tolerance: float = 0.0

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            nodes: Sequence[int],
            positions: ArrayLike,
            directions: str = "xyz",
            tolerance: float = 0.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "nodes", node_list("nodes", self.nodes))
        refuse_bad_directions(self.directions)
        shape = (len(self.directions), len(self.nodes))
        meaning = "a row per direction, a column per node"
        put(self, "positions", frozen(shaped("positions", self.positions, shape, meaning)))
        put(self, "tolerance", checked_tolerance(self.tolerance, "m"))

    @property
    def unit(self) -> str:
        """``"m"``."""
        return "m"

    @property
    def names(self) -> tuple[str, ...]:
        """``"x[0]"`` and so on, node by node."""
        return tuple(f"{axis}[{i}]" for i in self.nodes for axis in self.directions)

    @property
    def wanted(self) -> FloatArray:
        """The coordinates asked for, m, node by node."""
        return self.positions.ravel(order="F")

    def miss(self, N: Any) -> Any:
        """Return found less wanted coordinates.

        Parameters
        ----------
        N : casadi.SX, shape (3, n)
            Node positions, m.
        """
        found = N[axis_rows(self.directions), self.nodes.tolist()]
        return ca.vec(found) - ca.DM(self.wanted)

    def refuse_other_nodes(self, name: str, structure: Structure) -> None:
        """Raise if there is no such node.

        Parameters
        ----------
        name : str
            What the message calls the demand.
        structure : Structure
        """
        refuse_missing(f"{name}.nodes", self.nodes, structure)


@final
@dataclass(frozen=True, eq=False)
class PointAt(Demand):
    """A point of the structure at a given place: the mean of some nodes.

    Parameters
    ----------
    nodes : sequence of int, length k
        Nodes whose weighted mean the point is: the two ends of a bar for its
        centre, the top nodes of a prism for the centre of its top.
    position : array_like, shape (d,)
        Where it is to be, m.
    weights : array_like, shape (k,), optional
        Weight of each node; equal if not given. Their sum must not be 0.
    directions : str
        Which coordinates are asked for: letters out of ``"xyz"``.
    tolerance : float
        How far off each coordinate may be, m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.PointAt([0, 1, 2], [0.1, 0.0], directions="xy").names
    ('x of point', 'y of point')
    """

    nodes: IntArray
    position: FloatArray
    weights: FloatArray = None  # type: ignore[assignment]  # replaced in __post_init__
    directions: str = "xyz"
    tolerance: float = 0.0

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            nodes: Sequence[int],
            position: ArrayLike,
            weights: ArrayLike | None = None,
            directions: str = "xyz",
            tolerance: float = 0.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "nodes", node_list("nodes", self.nodes))
        refuse_bad_directions(self.directions)
        meaning = "one number per direction"
        place = shaped("position", self.position, (len(self.directions),), meaning)
        put(self, "position", frozen(place))
        given: Any = self.weights
        weights = np.ones(len(self.nodes)) if given is None else given
        weights = shaped("weights", weights, (len(self.nodes),), "one per node")
        if abs(weights.sum()) <= 1e-12 * np.abs(weights).sum():
            raise ValueError(f"weights add up to {weights.sum():g}, expected another sum than 0")
        put(self, "weights", frozen(weights / weights.sum()))
        put(self, "tolerance", checked_tolerance(self.tolerance, "m"))

    @property
    def unit(self) -> str:
        """``"m"``."""
        return "m"

    @property
    def names(self) -> tuple[str, ...]:
        """``"x of point"`` and so on."""
        return tuple(f"{axis} of point" for axis in self.directions)

    @property
    def wanted(self) -> FloatArray:
        """The place asked for, m."""
        return self.position

    def miss(self, N: Any) -> Any:
        """Return found less wanted place.

        Parameters
        ----------
        N : casadi.SX, shape (3, n)
            Node positions, m.
        """
        point = ca.mtimes(N[:, self.nodes.tolist()], ca.DM(self.weights))
        return point[axis_rows(self.directions)] - ca.DM(self.position)

    def refuse_other_nodes(self, name: str, structure: Structure) -> None:
        """Raise if there is no such node.

        Parameters
        ----------
        name : str
            What the message calls the demand.
        structure : Structure
        """
        refuse_missing(f"{name}.nodes", self.nodes, structure)
