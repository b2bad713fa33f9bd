"""What the drives of a plant cannot set, as equations of a search for shapes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    every_string,
    member_rows,
    of_members,
)
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.linear_plant import LinearPlant, refuse_driven_bars
from tenscontrol.structure.structure import same_members

# Ends of a path may miss the values of passive strings by this part of the largest.
_AT_ENDS = 1e-6


@dataclass(frozen=True, eq=False)
class HeldStrings:
    """What the winches of a plant cannot set: values of passive strings, and of shared winches.

    Attributes
    ----------
    actuation : Actuation
    input : {"rest_length", "force_density"}
        What the values are.
    struts : Actuation, optional
        That of bars whose lengths are driven.
    """

    actuation: Actuation
    input: str
    struts: Actuation | None = None

    @property
    def settles_forces(self) -> bool:
        """Whether no string is driven, so that the shape alone says what γ are."""
        return not len(self.actuation.lead)

    @property
    def driven_bars(self) -> IntArray:
        """Indices of the bars whose lengths are driven."""
        return np.zeros(0, dtype=np.int64) if self.struts is None else self.struts.driven

    def bar_rows(self, lengths: Any, orbits: FloatArray, unit: float) -> Any:
        """Return expressions that vanish where drives can give bars these lengths, of order one.

        Beside the lengths of bars that are not driven. Bars of one orbit, shape (β, orbits), have
        the same length.
        """
        if self.struts is None:
            return ca.SX(0, 1)
        return _shared(self.struts, lengths, orbits.argmax(axis=1), unit, set())

    def rows(self, model: Model, nodes: Any, gamma: Any, orbits: FloatArray, unit: float) -> Any:
        """Return expressions that vanish where winches can hold γ in a shape, of order one.

        ``unit`` is that of the values, m or N/m. Strings of one orbit, shape (α, orbits), have the
        same length and γ: each equation is written once.
        """
        values = gamma
        if self.input == "rest_length":
            assert model.strings is not None  # the plant has rest lengths
            length = kernel.string_lengths(model.structure, nodes).T
            values = model.strings.taut_rest_length(length, gamma)
        act, of = self.actuation, orbits.argmax(axis=1)
        offset = act.offset / unit
        rows, written = [ca.SX(0, 1)], set[tuple[float, ...]]()
        for i in act.passive.tolist():
            key: tuple[float, ...] = (float(of[i]), round(float(offset[i]), 9))
            if key not in written:
                rows.append(values[i] / unit - float(offset[i]))
            written.add(key)
        return ca.vertcat(*rows, _shared(act, values, of, unit, written))

    def spring_force_density(self, model: Model) -> FloatArray:
        """Return γ of the passive strings in the shape of the model, N/m."""
        passive, offset = self.actuation.passive, self.actuation.offset
        if self.input == "force_density":
            return np.asarray(offset[passive])
        assert model.strings is not None  # the plant has rest lengths
        wound = np.where(self.actuation.input < 0, offset, model.structure.string_length())
        return np.asarray(model.strings.force_density(model.structure.string_length(), wound))[
            passive
        ]

    def refuse_other(self, name: str, values: FloatArray) -> None:
        """Raise if an end of a path has values, shape (α,), that the winches cannot hold."""
        act, unit = self.actuation, "m" if self.input == "rest_length" else "N/m"
        held = act.offset.copy()
        inputs = values[act.lead] - act.offset[act.lead]
        inputs = inputs / act.ratio[act.lead]
        held[act.driven] += act.ratio[act.driven] * inputs[act.input[act.driven]]
        off = np.abs(values - held)
        i = int(off.argmax())
        if off[i] > _AT_ENDS * float(np.abs(values).max()):
            kind = "passive" if act.input[i] < 0 else "on a winch that it shares"
            raise ValueError(
                f"{name} has a {self.input.replace('_', ' ')} of {values[i]:.6g} {unit} in string "
                f"{i}, which is {kind} in plant and has {held[i]:.6g} {unit} there: make {name} by "
                "shape_target(..., plant=plant)"
            )


def _shared(
    act: Actuation, values: Any, of: IntArray, unit: float, written: set[tuple[float, ...]]
) -> Any:
    """Return expressions that vanish where members that share a drive move by their ratios.

    ``of`` is the orbit of each member, and ``written`` says which equations there are.
    """
    rows, offset = [ca.SX(0, 1)], act.offset / unit
    for i in np.setdiff1d(act.driven, act.lead).tolist():
        lead = int(act.lead[act.input[i]])
        ends = [(of[j], float(act.ratio[j]), round(float(offset[j]), 9)) for j in (i, lead)]
        key = (*ends[0], *ends[1])
        if ends[0] != ends[1] and key not in written:
            own, first = (
                (values[j] / unit - float(offset[j])) / float(act.ratio[j]) for j in (i, lead)
            )
            rows.append(own - first)
        written.add(key)
    return ca.vertcat(*rows)


def _plant(model: Model, name: str, plant: object) -> LinearPlant:
    """Return a plant of the structure of a model, or raise naming the argument."""
    validation.instance(name, plant, LinearPlant, "make one by linearize(..., actuated=...)")
    assert isinstance(plant, LinearPlant)  # just checked
    if not same_members(plant.model.structure, model.structure):
        raise ValueError(
            f"{name} is of {plant.model.structure!r}, expected one of the structure of the model, "
            f"{model.structure!r}"
        )
    return plant


def shape_drives(
    model: Model, plant: object, struts: object, winches: Winches | None, drives: Winches | None
) -> tuple[HeldStrings | None, Winches | None, Winches | None]:
    """Return what drives cannot set, and the limits of rest lengths and of lengths of bars.

    ``plant`` drives strings, or bars alone, which ``winches`` then limit; ``struts`` drives bars
    beside the strings, if ``plant`` does not drive both, and ``drives`` limit them.
    """
    if drives is not None:
        validation.instance("drives", drives, Winches, "make them by Winches(shortest=...)")
    if plant is not None and _plant(model, "plant", plant).input == "length":
        return _of_both(model, plant, struts), winches, drives
    if struts is None:
        if drives is not None:
            raise ValueError("drives limit bars that struts drives, but struts is not given")
        if plant is None or _plant(model, "plant", plant).input != "bar_length":
            return held_strings(model, plant), winches, None
        assert isinstance(plant, LinearPlant)  # just checked
        if model.strings is None:
            raise ValueError("plant has strings that keep rest lengths, but the model has no law")
        assert plant.rest_length is not None  # it has a law
        none = np.full(len(plant.rest_length), -1), np.zeros(len(plant.rest_length))
        passive = Actuation(*none, plant.rest_length, np.zeros(0, dtype=np.int64))
        return HeldStrings(passive, "rest_length", plant.actuation), None, winches
    bars = _plant(model, "struts", struts)
    if bars.input != "bar_length":
        raise ValueError(
            f"struts has the input {bars.input!r}, expected 'bar_length': linearize(model, rest, "
            "input='bar_length')"
        )
    if plant is not None and _plant(model, "plant", plant).input == "bar_length":
        raise ValueError(
            "plant and struts both drive bars: plant is for the strings, leave it out if all are "
            "driven; leave struts out if none is"
        )
    held = held_strings(model, plant)
    if held is None:
        every = every_string(len(model.structure.strings))
        held = HeldStrings(every, "force_density")
    return replace(held, struts=bars.actuation), winches, drives


def _of_both(model: Model, plant: object, struts: object) -> HeldStrings:
    """Return what a plant of strings and bars cannot set."""
    assert isinstance(plant, LinearPlant)  # checked before
    if struts is not None:
        raise ValueError("plant drives strings and bars: leave struts out")
    strings, bars = (
        of_members(plant.actuation, rows) for rows in member_rows("length", model.structure)
    )
    assert strings is not None  # without strings there is no such plant
    return HeldStrings(strings, "force_density" if strings.is_whole else "rest_length", bars)


def held_strings(model: Model, plant: object) -> HeldStrings | None:
    """Return what the winches of a plant cannot set; None where they set each string."""
    if plant is None:
        return None
    plant = _plant(model, "plant", plant)
    refuse_driven_bars(plant, "this search for motions")
    if plant.input == "rest_length" and model.strings is None:
        raise ValueError("plant has rest lengths as inputs, but the model has no string law")
    return None if plant.actuation.is_whole else HeldStrings(plant.actuation, plant.input)
