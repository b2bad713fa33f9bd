"""Tasks of robots: what is rewarded, what is seen of the goal, and when it is reached."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, freeze_arrays
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.structure import Structure


class Task(ABC):
    """What robots are to do. Nodes and velocities have the shape (count, d, n), m and m/s."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    @abstractmethod
    def check(self, structure: Structure) -> None:
        """Raise a ValueError if the task does not fit a structure.

        Parameters
        ----------
        structure : Structure
        """

    def seen(self, time: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return what a robot sees of its goal, shape (count, k); nothing as a rule.

        Parameters
        ----------
        time : ndarray, shape (count,), s
            Since the beginning of each episode, s.
        nodes : ndarray, shape (count, d, n), m
        """
        return np.zeros((len(nodes), 0))

    @abstractmethod
    def reward(self, time: FloatArray, before: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return the reward of a sample, shape (count,).

        Parameters
        ----------
        time : ndarray, shape (count,), s
            At its end, s.
        before, nodes : ndarray, shape (count, d, n), m
            At its beginning and at its end.
        """

    def is_reached(self, nodes: FloatArray) -> np.ndarray:
        """Return which robots are done, shape (count,); none as a rule.

        Parameters
        ----------
        nodes : ndarray, shape (count, d, n), m
        """
        return np.zeros(len(nodes), dtype=bool)


@dataclass(frozen=True, eq=False)
class Rolling(Task):
    """Go along a direction: the reward is the way of the centre of the nodes along it, m.

    Parameters
    ----------
    direction : array_like, shape (d,)
        Its length does not count.

    Raises
    ------
    TypeError, ValueError
        If it is not finite, or has no length.
    """

    direction: Any

    def __post_init__(self) -> None:
        along = np.atleast_1d(validation.vector("direction", self.direction))
        object.__setattr__(self, "direction", validation.direction("direction", along, len(along)))
        freeze_arrays(self)

    def check(self, structure: Structure) -> None:
        """See :meth:`Task.check`.

        Parameters
        ----------
        structure : Structure
        """
        if len(self.direction) != structure.dimension:
            raise ValueError(
                f"direction has {len(self.direction)} entries, expected {structure.dimension}"
            )

    def reward(self, time: FloatArray, before: FloatArray, nodes: FloatArray) -> FloatArray:
        """See :meth:`Task.reward`.

        Parameters
        ----------
        time : ndarray, shape (count,), s
        before, nodes : ndarray, shape (count, d, n), m
        """
        return np.asarray((nodes - before).mean(axis=2) @ self.direction)


@dataclass(frozen=True, eq=False)
class Reach(Task):
    """Bring a node to a place: the reward is by how much nearer it comes, m; an episode ends there.

    Parameters
    ----------
    node : int
    place : array_like, shape (d,)
        m.
    tolerance : float
        How near it must come, m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or not finite.
    """

    node: int
    place: Any
    tolerance: float = 0.01

    def __post_init__(self) -> None:
        validation.whole_number("node", self.node, 0)
        object.__setattr__(self, "place", validation.vector("place", self.place))
        validation.positive_number("tolerance", self.tolerance, "m")
        freeze_arrays(self)

    def check(self, structure: Structure) -> None:
        """See :meth:`Task.check`.

        Parameters
        ----------
        structure : Structure
        """
        _refuse_other_node(self.node, structure)
        if len(self.place) != structure.dimension:
            raise ValueError(f"place has {len(self.place)} entries, expected {structure.dimension}")

    def seen(self, time: FloatArray, nodes: FloatArray) -> FloatArray:
        """See :meth:`Task.seen`: the way that is left.

        Parameters
        ----------
        time : ndarray, shape (count,), s
        nodes : ndarray, shape (count, d, n), m
        """
        return np.asarray(self.place - nodes[:, :, self.node])

    def reward(self, time: FloatArray, before: FloatArray, nodes: FloatArray) -> FloatArray:
        """See :meth:`Task.reward`.

        Parameters
        ----------
        time : ndarray, shape (count,), s
        before, nodes : ndarray, shape (count, d, n), m
        """
        return np.asarray(self._left(before) - self._left(nodes))

    def is_reached(self, nodes: FloatArray) -> np.ndarray:
        """See :meth:`Task.is_reached`.

        Parameters
        ----------
        nodes : ndarray, shape (count, d, n), m
        """
        return np.asarray(self._left(nodes) <= self.tolerance)

    def _left(self, nodes: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(nodes[:, :, self.node] - self.place, axis=1))


@dataclass(frozen=True, eq=False)
class Track(Task):
    """Keep a node at a moving place: the reward is minus its distance from it, m, in each sample.

    Parameters
    ----------
    node : int
    path : callable
        ``(time) -> place``, of times (count,), s, to shape (count, d), m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind.
    """

    node: int
    path: Callable[[FloatArray], Any]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        validation.whole_number("node", self.node, 0)
        validation.function("path", self.path, "it takes times (count,), s, to places (count, d)")

    def check(self, structure: Structure) -> None:
        """See :meth:`Task.check`.

        Parameters
        ----------
        structure : Structure
        """
        _refuse_other_node(self.node, structure)
        self.seen(np.zeros(2), np.stack([structure.nodes] * 2))

    def seen(self, time: FloatArray, nodes: FloatArray) -> FloatArray:
        """See :meth:`Task.seen`: the way to where the node should be.

        Parameters
        ----------
        time : ndarray, shape (count,), s
        nodes : ndarray, shape (count, d, n), m
        """
        place = validation.shaped(
            "what path returns", self.path(time), nodes.shape[:2], "one place a time"
        )
        return np.asarray(place - nodes[:, :, self.node])

    def reward(self, time: FloatArray, before: FloatArray, nodes: FloatArray) -> FloatArray:
        """See :meth:`Task.reward`.

        Parameters
        ----------
        time : ndarray, shape (count,), s
        before, nodes : ndarray, shape (count, d, n), m
        """
        return -np.asarray(np.linalg.norm(self.seen(time, nodes), axis=1))


def _refuse_other_node(node: int, structure: Structure) -> None:
    count = structure.nodes.shape[1]
    if node >= count:
        raise ValueError(f"node is {node}, expected at most {count - 1}")
