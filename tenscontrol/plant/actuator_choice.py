"""Choice of the strings that are worth a motor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.plant.controllability import normalized_input, reached_states, refuse_empty
from tenscontrol.plant.linear_plant import (
    LinearPlant,
    clusters,
    refuse_driven_bars,
    squared_frequencies,
)
from tenscontrol.short_repr import short_repr

# Squared reach of a mode below this part of the largest counts as none.
_NOTHING = 1e-9

# Gains this close to each other, relative to the largest, are equal: by symmetry many are.
_EQUAL = 1e-6


@dataclass(frozen=True, eq=False)
class ActuatorChoice:
    """Inputs of a plant in the order of their worth. Made by :func:`actuator_choice`.

    Attributes
    ----------
    input : ndarray of int, shape (k,)
        Inputs of the plant, the one worth most first.
    string : ndarray of int, shape (k,)
        The string of each, its lead if it is ganged.
    name : tuple of str
        Their names.
    unreachable : ndarray of int, shape (k,)
        Number of states that the first 1, 2, … of them do not reach.
    margin : ndarray, shape (k,)
        How well they reach the pole that they reach least, of those that they reach: as in
        :class:`Controllability`, but relative to the largest acceleration by all inputs.
    """

    input: IntArray
    string: IntArray
    name: tuple[str, ...]
    unreachable: IntArray
    margin: FloatArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def table(self) -> str:
        """Return the choice as text, one input a line.

        Returns
        -------
        str
        """
        width = max(len("input"), *map(len, self.name))
        lines = [f"motors  {'input':{width}s}  string  unreached states  least margin"]
        columns = self.name, self.string, self.unreachable, self.margin
        for number, (name, string, lost, margin) in enumerate(zip(*columns, strict=True), start=1):
            lines.append(f"{number:6d}  {name:{width}s}  {string:6d}  {lost:16d}  {margin:12.3g}")
        return "\n".join(lines)


def actuator_choice(plant: LinearPlant, count: int | None = None) -> ActuatorChoice:
    """Return the inputs of a plant that reach most, chosen one after the other.

    Parameters
    ----------
    plant : LinearPlant
        Its inputs are the candidates: every string, or those of ``actuated``.
    count : int, optional
        How many to choose; all if not given.

    Returns
    -------
    ActuatorChoice

    Raises
    ------
    TypeError, ValueError
        If ``plant`` is not a linear plant or has no inputs, or ``count`` is no number of them.

    Notes
    -----
    Greedy: each input adds most to ``Σ log det(ε I + b bᵀ)`` over groups of modes of one frequency,
    with b the accelerations of these modes by the inputs chosen. That is the mean controllability
    Gramian of the undamped plant; its logarithm is submodular, and the greedy choice near the best
    (Summers, Cortesi & Lygeros 2016, doi:10.1109/TCNS.2015.2453711). As ε is small, the first
    inputs reach as many modes as they can. Of inputs worth the same the first is taken.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> plant = tc.linearize(model, rest, input="rest_length")
    >>> choice = tc.actuator_choice(plant, count=3)
    >>> print(choice.table())
    motors  input               string  unreached states  least margin
         1  rest_length_top[0]       0                 6       0.00437
         2  rest_length_top[1]       1                 0       0.00618
         3  rest_length_top[2]       2                 0       0.00757
    >>> tc.linearize(model, rest, input="rest_length", actuated=choice.string)
    LinearPlant(9 internal coordinates, input rest_length, 3 inputs)
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    refuse_driven_bars(plant, "actuator_choice")
    refuse_empty(plant)
    inputs = plant.B.shape[1]
    count = inputs if count is None else validation.whole_number("count", count, 1, inputs)
    chosen = _greedy(plant, count)
    unreachable, margins = [], []
    largest = float(np.linalg.norm(plant.B, 2)) or 1.0
    for number in range(1, count + 1):
        some = replace(plant, B=plant.B[:, chosen[:number]])
        reached = reached_states(some)
        unreachable.append(len(plant.A) - reached.count)
        share = float(np.linalg.norm(some.B, 2)) / largest
        some_reached = reached.margin[reached.margin > _NOTHING]
        margins.append(share * float(some_reached.min(initial=np.inf)) if reached.count else 0.0)
    names = plant.input_names
    return ActuatorChoice(
        input=chosen,
        string=plant.actuation.lead[chosen],
        name=tuple(names[i] for i in chosen),
        unreachable=np.array(unreachable),
        margin=np.array(margins),
    )


def _greedy(plant: LinearPlant, count: int) -> IntArray:
    """Return inputs in the order of what they add."""
    r = plant.degrees_of_freedom
    squares, modes = squared_frequencies(-plant.A[r:, :r])
    rows = modes.T @ normalized_input(plant)[r:]
    groups = [rows[first:last] for first, last in clusters(squares)]
    inverses = [np.eye(len(group)) / _NOTHING for group in groups]
    left, chosen = np.ones(rows.shape[1], bool), []
    for _ in range(count):
        pushed = [inverse @ group for inverse, group in zip(inverses, groups, strict=True)]
        pairs = list(zip(pushed, groups, strict=True))
        gains = [1 + (push * group).sum(axis=0) for push, group in pairs]
        worth = np.where(left, np.log(gains).sum(axis=0), -np.inf)
        best = int(np.flatnonzero(worth >= worth.max() - _EQUAL * abs(worth.max()))[0])
        left[best] = False
        chosen.append(best)
        for inverse, push, gain in zip(inverses, pushed, gains, strict=True):
            inverse -= np.outer(push[:, best], push[:, best]) / gain[best]
    return np.array(chosen)
