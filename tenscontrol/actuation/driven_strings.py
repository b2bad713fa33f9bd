"""Driven strings, as a map from inputs to the values of strings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays, frozen
from tenscontrol.properties import cached_property
from tenscontrol.structure.structure import Structure

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# What is left of a sum of two numbers that cancel, as part of them, at most.
_ROUND_OFF = 4 * float(np.finfo(float).eps)


#: Inputs that drive bars: alone, or after strings.
BAR_INPUTS = ("bar_length", "length")


def member_rows(input: str, commanded: Structure) -> tuple[slice, slice]:
    """Return which values that a command sets are those of strings, and which those of bars."""
    strings = 0 if input == "bar_length" else len(commanded.strings)
    bars = len(commanded.bars) if input in BAR_INPUTS else 0
    return slice(0, strings), slice(strings, strings + bars)


@dataclass(frozen=True)
class _Members:
    """Members that are driven: strings by winches, or bars by drives."""

    argument: str  # in which the user gives them
    noun: str
    drive: str
    count: int
    forms: str  # in which they are given
    listed: Callable[[str, object], list[int]]  # the members of a list, by the list's name


@dataclass(frozen=True, eq=False)
class Actuation:
    """The map from the inputs of a plant to all of its strings, ``offset + matrix @ inputs``.

    With lengths of bars as inputs, the map to bars, or to strings and then bars.

    The values are rest lengths, m, or force densities, N/m, as the plant has them for its input. A
    string that no input drives is passive: it keeps its offset. Strings that share an input are
    ganged: one winch moves them all, each by its ratio. The value of an input is that of its lead,
    the first of its strings with a positive ratio, over this ratio. Made by :func:`linearize`.

    Attributes
    ----------
    input : ndarray of int, shape (α,)
        The input that drives each string, -1 for none.
    ratio : ndarray, shape (α,)
        By how much each string moves where its input moves by 1; 0 for passive strings.
    offset : ndarray, shape (α,)
        Values of the strings at inputs of 0, m or N/m.
    lead : ndarray of int, shape (m,)
        The string that gives each input its value.
    names : tuple of str
        Names of the inputs; empty if they are those of their leads.

    Examples
    --------
    A prism with a winch for each vertical string, and one for its three top strings:

    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> model, rest = tc.Model(prism), tc.prestress(prism, force_density=10.0)
    >>> groups = {"lid": ["top"], "a": [6], "b": [7], "c": [8]}
    >>> actuation = tc.linearize(model, rest, actuated=groups).actuation
    >>> actuation
    Actuation(4 inputs drive 6 of 9 strings)
    >>> actuation.passive
    array([3, 4, 5])
    >>> actuation.strings([20.0, 30.0, 31.0, 32.0]).round(1)
    array([20., 20., 20., 10., 10., 10., 30., 31., 32.])
    """

    input: IntArray
    ratio: FloatArray
    offset: FloatArray
    lead: IntArray
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @cached_property
    def is_whole(self) -> bool:
        """Whether each string is an input, in order."""
        count = len(self.input)
        return (
            len(self.lead) == count
            and bool((self.lead == np.arange(count)).all())
            and bool((self.ratio == 1).all())
        )

    @cached_property
    def is_ganged(self) -> bool:
        """Whether a winch drives more than one string, or by a ratio other than 1."""
        return len(self.driven) > len(self.lead) or bool((self.ratio[self.driven] != 1).any())

    @cached_property
    def driven(self) -> IntArray:
        """Indices of the strings that inputs drive."""
        return frozen(np.flatnonzero(self.input >= 0))

    @cached_property
    def passive(self) -> IntArray:
        """Indices of the strings that no input drives."""
        return frozen(np.flatnonzero(self.input < 0))

    @property
    def matrix(self) -> csr_array:
        """G, shape (α, m), sparse: change of the strings by the inputs."""
        from scipy.sparse import csr_array

        strings = self.driven
        where = self.ratio[strings], (strings, self.input[strings])
        return csr_array(where, shape=(len(self.input), len(self.lead)))

    def strings(self, inputs: object) -> FloatArray:
        """Return the values of all strings at inputs.

        Parameters
        ----------
        inputs : array_like, shape (m,) or (m, K)
            m or N/m.

        Returns
        -------
        ndarray, shape (α,) or (α, K)
        """
        values = _checked("inputs", inputs, len(self.lead), "input")
        return strings_of(self, values)

    def inputs(self, strings: object) -> FloatArray:
        """Return the inputs that hold strings at values: those of the leads, by their ratios.

        Parameters
        ----------
        strings : array_like, shape (α,) or (α, K)
            m or N/m.

        Returns
        -------
        ndarray, shape (m,) or (m, K)
        """
        values = _checked("strings", strings, len(self.input), "string")
        return inputs_of(self, values)

    def __repr__(self) -> str:
        count, inputs = len(self.driven), len(self.lead)
        return (
            f"Actuation({inputs} input{'s' * (inputs != 1)} "
            f"drive{'s' * (inputs == 1)} {count} of {len(self.input)} strings)"
        )


def _checked(name: str, value: object, count: int, of: str) -> FloatArray:
    array = validation.float_array(name, value)
    if array.ndim not in (1, 2) or len(array) != count:
        raise ValueError(
            f"{name} has shape {array.shape}, expected ({count},) or ({count}, K): one row per {of}"
        )
    return array


def strings_of(actuation: Actuation, inputs: FloatArray) -> FloatArray:
    """Return the values of all strings at inputs, one column or several, unchecked.

    A string that an input just takes to 0 is there, and not past it by round-off.
    """
    if actuation.is_whole:
        return inputs
    values = actuation.offset + moved_by(actuation, inputs.T)
    values[np.abs(values) <= _ROUND_OFF * np.abs(actuation.offset)] = 0.0
    return np.asarray(values.T)


def inputs_of(actuation: Actuation, strings: FloatArray) -> FloatArray:
    """Return the inputs that hold leads at values, one column or several, unchecked."""
    if actuation.is_whole:
        return strings
    return np.asarray((strings[actuation.lead].T / actuation.ratio[actuation.lead]).T)


def moved_by(actuation: Actuation, inputs: FloatArray) -> FloatArray:
    """Return what inputs move the strings by; both on the last axis."""
    driven = actuation.driven
    values = np.zeros((*inputs.shape[:-1], len(actuation.input)))
    values[..., driven] = actuation.ratio[driven] * inputs[..., actuation.input[driven]]
    return values


def polynomials_of(actuation: Actuation, inputs: FloatArray) -> FloatArray:
    """Return polynomials in time of all members, (α, K), ascending, of those of the inputs."""
    if actuation.is_whole:
        return inputs
    moved = moved_by(actuation, inputs.T).T
    moved[:, 0] += actuation.offset
    return moved


def forces_on_inputs(actuation: Actuation, tensions: FloatArray) -> FloatArray:
    """Return Gᵀ T, the forces that strings exert on the inputs, (m, K), of their tensions, (α, K).

    An input gives the power that its strings take: a string counts by its ratio.
    """
    if not actuation.is_ganged:
        return np.asarray(tensions[actuation.lead])
    return sums_by_input(actuation, (actuation.ratio * tensions.T).T)


def sums_by_input(actuation: Actuation, values: FloatArray) -> FloatArray:
    """Return the sum over the strings of each input, (m, K), of values of strings, (α, K)."""
    if not actuation.is_ganged:
        return np.asarray(values[actuation.lead])
    sums = np.zeros((len(actuation.lead), *values.shape[1:]))
    np.add.at(sums, actuation.input[actuation.driven], values[actuation.driven])
    return sums


def bounds_of_inputs(
    actuation: Actuation, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return least and largest inputs, shape (m,), that keep driven strings within bounds, (α,)."""
    if actuation.is_whole:
        return low, high
    strings, count = actuation.driven, len(actuation.lead)
    of = actuation.input[strings]
    ratio, offset = actuation.ratio[strings], actuation.offset[strings]
    ends = (low[strings] - offset) / ratio, (high[strings] - offset) / ratio
    least, most = np.full(count, -np.inf), np.full(count, np.inf)
    np.maximum.at(least, of, np.minimum(*ends))
    np.minimum.at(most, of, np.maximum(*ends))
    return least, most


def changes_of_inputs(actuation: Actuation, change: FloatArray) -> FloatArray:
    """Return the largest changes of the inputs, shape (m,), by those of the strings, (α,)."""
    if actuation.is_whole:
        return change
    strings, most = actuation.driven, np.full(len(actuation.lead), np.inf)
    np.minimum.at(
        most, actuation.input[strings], change[strings] / np.abs(actuation.ratio[strings])
    )
    return most


def through(actuation: Actuation, values: FloatArray) -> Actuation:
    """Return the same winches where strings have these values, shape (α,)."""
    if actuation.is_whole:
        return actuation
    return replace(actuation, offset=values - moved_by(actuation, inputs_of(actuation, values)))


def follows(actuation: Actuation, other: Actuation) -> bool:
    """Whether some inputs move the strings as any inputs of another actuation move them."""
    if actuation.is_whole:
        return True
    moves = other.matrix.toarray()
    return bool(
        np.allclose(moved_by(actuation, inputs_of(actuation, moves).T), moves.T, atol=1e-12)
    )


def moves_alike(actuation: Actuation, other: Actuation) -> bool:
    """Whether equal inputs of two actuations give strings equal values."""
    return bool(
        np.array_equal(actuation.input, other.input)
        and np.array_equal(actuation.ratio, other.ratio)
        and np.allclose(actuation.offset, other.offset, rtol=1e-9, atol=0)
        and np.array_equal(actuation.lead, other.lead)
    )


def refuse_passive(actuation: Actuation, name: str, strings: IntArray) -> None:
    """Raise if a string is passive: what acts on its winch acts on nothing."""
    passive = np.intersect1d(strings, actuation.passive)
    if len(passive):
        raise ValueError(
            f"{name} is of string {passive[0]}, which no winch drives: it is not among actuated of "
            "the plant that the controller was designed on"
        )


def side_by_side(
    first: Actuation, second: Actuation, names: tuple[tuple[str, ...], tuple[str, ...]]
) -> Actuation:
    """Return the actuation of the members and inputs of one, and then of those of another.

    ``names`` are those of the inputs of each, used where either has names of its own.
    """
    members, inputs = len(first.input), len(first.lead)
    of_second = np.where(second.input < 0, -1, second.input + inputs)
    return Actuation(
        np.append(first.input, of_second),
        np.append(first.ratio, second.ratio),
        np.append(first.offset, second.offset),
        np.append(first.lead, second.lead + members),
        sum(names, ()) if first.names or second.names else (),
    )


def of_members(actuation: Actuation, rows: slice) -> Actuation | None:
    """Return the actuation of some members and their inputs, which follow each other; None of none.

    ``rows`` are one of :func:`member_rows`.
    """
    if rows.start == 0 and rows.stop >= len(actuation.input):
        return actuation
    if rows.stop <= rows.start:
        return None
    first = int((actuation.lead < rows.start).sum())
    lead = actuation.lead[first : first + int((actuation.lead[first:] < rows.stop).sum())]
    of, names = actuation.input[rows], actuation.names[first : first + len(lead)]
    of = np.where(of < 0, -1, of - first)
    own = actuation.ratio[rows], actuation.offset[rows]
    return Actuation(of, *own, lead - rows.start, names)


def every_string(count: int) -> Actuation:
    """Return the actuation of strings that are each an input."""
    strings = np.arange(count)
    return Actuation(strings, np.ones(count), np.zeros(count), strings)


def actuation_of(structure: Structure, actuated: object, values: FloatArray) -> Actuation:
    """Return which strings are driven, from what the user gave, where strings have these values.

    Parameters
    ----------
    structure : Structure
    actuated : sequence of int or str, dict, array_like, Actuation or None
        See :func:`linearize`.
    values : ndarray, shape (α,)
        Rest lengths, m, or force densities, N/m, through which the map goes.

    Returns
    -------
    Actuation
    """
    forms = (
        "indices and groups of strings, {name: strings} with strings that share a winch, or a "
        "matrix of shape (α, m)"
    )
    listed = partial(_listed, structure, forms)
    strings = _Members("actuated", "string", "winch", len(structure.strings), forms, listed)
    return _actuation_of(strings, actuated, values)


def actuation_of_bars(name: str, actuated: object, lengths: FloatArray) -> Actuation:
    """Return which bars are driven, from what the user gave, where bars have these lengths.

    As :func:`actuation_of`, of bars by index: values are their lengths, m, shape (β,). ``name`` is
    that of the argument.
    """
    count = len(lengths)

    def listed(name: str, given: object) -> list[int]:
        return [int(number) for number in validation.index_list(name, given, count, "bars")]

    forms = (
        "indices of bars, {name: bars} with bars that share a drive, or a matrix of shape (β, m)"
    )
    return _actuation_of(_Members(name, "bar", "drive", count, forms, listed), actuated, lengths)


def _actuation_of(members: _Members, actuated: object, values: FloatArray) -> Actuation:
    """Return which members are driven, where members have these values."""
    argument = members.argument
    if actuated is None:
        return every_string(members.count)
    if isinstance(actuated, Actuation):
        if len(actuated.input) != members.count:
            raise ValueError(
                f"{argument} is {actuated!r}, but the structure has {members.count} "
                f"{members.noun}s: take that of a plant of the same structure"
            )
        return through(actuated, values)
    names: tuple[str, ...] = ()
    if isinstance(actuated, Mapping):
        names = tuple(validation.identifier(f"a name in {argument}", name) for name in actuated)
        drives = [
            _ganged(members, f"{argument}[{name!r}]", group) for name, group in actuated.items()
        ]
    elif isinstance(actuated, np.ndarray) and actuated.ndim == 2:
        drives = _columns(members, actuated)
    else:
        drives = [{number: 1.0} for number in members.listed(argument, actuated)]
    return _together(members, drives, names, values)


def _together(
    members: _Members, drives: list[dict[int, float]], names: tuple[str, ...], values: FloatArray
) -> Actuation:
    """Return the actuation of drives, each a ratio by member, where members have these values."""
    noun, drive, count, argument = (
        members.noun, members.drive, members.count, members.argument
    )  # fmt: skip
    if not drives:
        raise ValueError(f"{argument} is empty, expected {members.forms}")
    of, ratio = np.full(count, -1), np.zeros(count)
    leads = []
    for number, ratios in enumerate(drives):
        name = f"{argument}[{names[number]!r}]" if names else argument
        for member, by in ratios.items():
            if of[member] >= 0:
                raise ValueError(
                    f"{name} has {noun} {member}, which another {drive} drives already; expected "
                    f"one {drive} a {noun}"
                )
            of[member], ratio[member] = number, by
        positive = [member for member, by in ratios.items() if by > 0]
        if not positive:
            raise ValueError(
                f"{name} has no {noun} with a positive ratio; expected at least one in each "
                f"{drive}: turn its signs"
            )
        leads.append(min(positive))
    lead = np.array(leads)
    return through(Actuation(of, ratio, np.zeros(count), lead, names), values)


def _listed(structure: Structure, forms: str, name: str, given: object) -> list[int]:
    """Return strings that are listed by index, group or mask."""
    if isinstance(given, str):
        given = [given]
    if isinstance(given, list | tuple) and any(isinstance(entry, list | tuple) for entry in given):
        raise ValueError(
            f"{name} has a list in a list, expected {forms}: strings that share a winch go in a "
            "dict, {'pair': [0, 1]}"
        )
    if not isinstance(given, list | tuple) or not any(isinstance(entry, str) for entry in given):
        numbers = validation.index_list(name, given, len(structure.strings), "strings")
        return [int(number) for number in numbers]
    strings: dict[int, None] = {}
    for i, entry in enumerate(given):
        if isinstance(entry, str):
            validation.choice(f"{name}[{i}]", entry, dict.fromkeys(structure.string_groups))
            strings |= dict.fromkeys(structure.strings_in(entry).tolist())
        else:
            number = np.array([validation.number(f"{name}[{i}]", entry, "index of a string")])
            checked = validation.indices(name, number, len(structure.strings), "strings")
            strings[int(checked[0])] = None
    return list(strings)


def _ganged(members: _Members, name: str, group: object) -> dict[int, float]:
    """Return the ratio of each member of one drive."""
    if not isinstance(group, Mapping):
        if isinstance(group, int | np.integer) and not isinstance(group, bool):
            group = [group]
        return dict.fromkeys(members.listed(name, group), 1.0)
    noun = members.noun
    ratios: dict[int, float] = {}
    for key, ratio in group.items():
        by = validation.number(f"{name}[{key!r}]", ratio, f"ratio of the {noun}")
        if by == 0:
            raise ValueError(f"{name}[{key!r}] is 0, by which nothing moves: leave it out")
        for member in members.listed(name, [key]):
            if member in ratios:
                raise ValueError(f"{name} has {noun} {member} twice; expected one ratio a {noun}")
            ratios[member] = by
    return ratios


def _columns(members: _Members, matrix: np.ndarray) -> list[dict[int, float]]:
    """Return the drives of a matrix, shape (members, m), column by column."""
    noun, drive, count, argument = (
        members.noun, members.drive, members.count, members.argument
    )  # fmt: skip
    array = validation.float_array(argument, matrix)
    if len(array) != count:
        raise ValueError(
            f"{argument} has shape {array.shape}, expected ({count}, m): one row per {noun}, one "
            f"column per {drive}"
        )
    empty = np.flatnonzero(~array.any(axis=0))
    if len(empty):
        raise ValueError(f"{argument} has a column of zeros, {empty[0]}: a {drive} without {noun}s")
    return [{int(i): float(column[i]) for i in np.flatnonzero(column)} for column in array.T]
