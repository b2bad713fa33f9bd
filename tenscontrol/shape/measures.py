"""What a shape is asked for as a whole: its height and its twist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import casadi as ca
import numpy as np

from tenscontrol.shape.checks import checked_tolerance, node_list, one_number, refuse_missing
from tenscontrol.shape.constraints import Demand
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray, frozen, shaped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


@final
@dataclass(frozen=True, eq=False)
class Height(Demand):
    """A distance between the centres of two sets of nodes, measured along an axis.

    Parameters
    ----------
    height : float
        m; from ``bottom`` to ``top`` along the axis.
    top, bottom : sequence of int
        The nodes whose means are the centres.
    axis : array_like, shape (3,)
        Direction; its length plays no part.
    tolerance : float
        m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
    >>> target = tc.shape_target(tc.Model(tc.prism()), low, force_density=17.3205)
    >>> target.nodes[2].round(3)
    array([0.925, 0.925, 0.925, 0.075, 0.075, 0.075])
    """

    height: float
    top: IntArray
    bottom: IntArray
    axis: FloatArray = (0.0, 0.0, 1.0)  # type: ignore[assignment]  # replaced in __post_init__
    tolerance: float = 0.0

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            height: float,
            top: Sequence[int],
            bottom: Sequence[int],
            axis: ArrayLike = (0.0, 0.0, 1.0),
            tolerance: float = 0.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "height", one_number("height", self.height, "m"))
        put(self, "top", node_list("top", self.top))
        put(self, "bottom", node_list("bottom", self.bottom))
        axis = shaped("axis", self.axis, (3,), "a direction")
        length = float(np.linalg.norm(axis))
        if length == 0:
            raise ValueError("axis is 0, expected a direction")
        put(self, "axis", frozen(axis / length))
        put(self, "tolerance", checked_tolerance(self.tolerance, "m"))

    @property
    def unit(self) -> str:
        """``"m"``."""
        return "m"

    @property
    def names(self) -> tuple[str, ...]:
        """``("height",)``."""
        return ("height",)

    @property
    def wanted(self) -> FloatArray:
        """The height, m, shape (1,)."""
        return np.array([self.height])

    def miss(self, N: Any) -> Any:
        """Return found less wanted height.

        Parameters
        ----------
        N : casadi.SX, shape (3, n)
            Node positions, m.
        """
        return ca.dot(ca.DM(self.axis), _centre(N, self.top) - _centre(N, self.bottom)) - ca.DM(
            self.height
        )

    def refuse_other_nodes(self, name: str, structure: Structure) -> None:
        """Raise if there is no such node.

        Parameters
        ----------
        name : str
            What the message calls the demand.
        structure : Structure
        """
        refuse_missing(f"{name}.top", self.top, structure)
        refuse_missing(f"{name}.bottom", self.bottom, structure)


@final
@dataclass(frozen=True, eq=False)
class Twist(Demand):
    """A turn of one set of nodes against another, about the line through their centres.

    Positive as a right-handed screw, whichever set is called top:
    :func:`prism` has ``π/2 − π/q`` if right-handed, and the opposite if
    left-handed.

    Parameters
    ----------
    angle : float
        rad.
    top, bottom : sequence of int, length k
        Nodes in pairs: the turn that brings the k-th of ``bottom`` in line
        with the k-th of ``top``, in the mean of least squares.
    tolerance : float
        rad.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> turned = tc.Twist(np.radians(-25.0), top=[0, 1, 2], bottom=[3, 4, 5])
    >>> turned.names, turned.unit
    (('twist',), 'rad')
    """

    angle: float
    top: IntArray
    bottom: IntArray
    tolerance: float = 0.0

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            angle: float,
            top: Sequence[int],
            bottom: Sequence[int],
            tolerance: float = 0.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "angle", one_number("angle", self.angle, "rad"))
        put(self, "top", node_list("top", self.top))
        put(self, "bottom", node_list("bottom", self.bottom))
        if len(self.top) != len(self.bottom) or len(self.top) < 2:
            raise ValueError(
                f"top has {len(self.top)} nodes and bottom {len(self.bottom)}, "
                "expected as many of each, two at least: they are compared in pairs"
            )
        put(self, "tolerance", checked_tolerance(self.tolerance, "rad"))

    @property
    def unit(self) -> str:
        """``"rad"``."""
        return "rad"

    @property
    def names(self) -> tuple[str, ...]:
        """``("twist",)``."""
        return ("twist",)

    @property
    def wanted(self) -> FloatArray:
        """The angle, rad, shape (1,)."""
        return np.array([self.angle])

    def miss(self, N: Any) -> Any:
        """Return found less wanted angle, between −π and π.

        Parameters
        ----------
        N : casadi.SX, shape (3, n)
            Node positions, m.
        """
        upper, lower = _centre(N, self.top), _centre(N, self.bottom)
        line = (upper - lower) / ca.norm_2(upper - lower)
        sine, cosine = ca.SX(0), ca.SX(0)
        for i, j in zip(self.top.tolist(), self.bottom.tolist(), strict=True):
            t, b = N[:, i] - upper, N[:, j] - lower
            sine += ca.dot(line, ca.cross(b, t))
            cosine += ca.dot(b, t) - ca.dot(line, b) * ca.dot(line, t)
        s, c = float(np.sin(self.angle)), float(np.cos(self.angle))
        # Turned back by the angle that is wanted, so that no jump is near.
        return ca.atan2(c * sine - s * cosine, c * cosine + s * sine)

    def refuse_other_nodes(self, name: str, structure: Structure) -> None:
        """Raise if there is no such node.

        Parameters
        ----------
        name : str
            What the message calls the demand.
        structure : Structure
        """
        refuse_missing(f"{name}.top", self.top, structure)
        refuse_missing(f"{name}.bottom", self.bottom, structure)


def _centre(N: Any, nodes: IntArray) -> Any:
    return ca.sum2(N[:, nodes.tolist()]) / len(nodes)
