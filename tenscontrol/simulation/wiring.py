"""Which strings of a plant a controller commands."""

from __future__ import annotations

import numpy as np

from tenscontrol.control.controller import Controller
from tenscontrol.dynamics import Model, StringLaw
from tenscontrol.structure import same_members, spread_force_density, spread_rest_length
from tenscontrol.validation import FloatArray, per_member, positive


class Wiring:
    """Which strings of the plant a controller commands: its own, or the segments of each.

    Parameters
    ----------
    controller : Controller
    model : Model
        Of the plant.

    Attributes
    ----------
    structure : Structure
        That of the plant.
    count : int
        Number α of strings commanded.

    Raises
    ------
    ValueError
        If the controller was designed on another structure than that of the model or its parent.
    """

    def __init__(self, controller: Controller, model: Model) -> None:
        structure, designed = model.structure, controller.plant.commanded
        seen = controller.plant.model.structure
        self.structure = structure
        self.count = len(designed.strings)
        self._cut = not same_members(designed, structure)
        parent = structure.parent
        fits = same_members(seen, structure)
        if self._cut:
            whole = parent is not None and structure.string_parent is not None
            fits = whole and same_members(designed, parent) and (fits or seen is designed)
        if not fits:
            raise ValueError(
                f"the controller was designed on {seen!r}, but the model has {structure!r} "
                "with other bars, strings or fixed nodes, and is no direct subdivision of it"
            )

    def checked_rest_length(self, rest_length: object) -> FloatArray:
        """Return where the winches stand, one a string of the controller."""
        values = per_member("rest_length", rest_length, self.count, "string of the controller")
        return positive("rest_length", values, "length in m")

    def gather(self, values: FloatArray) -> FloatArray:
        """Return the sum over the segments of each commanded string."""
        if not self._cut:
            return values
        total = np.zeros(self.count)
        assert self.structure.string_parent is not None  # a subdivision
        np.add.at(total, self.structure.string_parent, values)
        return total

    def gather_force_density(self, gamma: FloatArray) -> FloatArray:
        """Return γ of each commanded string, the mean over its segments."""
        if not self._cut:
            return gamma
        segments = self.gather(np.ones_like(gamma))
        return self.gather(gamma) / segments**2

    def spread_force_density(self, gamma: FloatArray) -> FloatArray:
        """Return γ of each string of the plant."""
        return spread_force_density(self.structure, gamma) if self._cut else gamma

    def spread_rest_length(self, rest_length: FloatArray) -> FloatArray:
        """Return the rest length of each string of the plant."""
        return spread_rest_length(self.structure, rest_length) if self._cut else rest_length

    def refuse_unreachable(self, law: StringLaw, most: FloatArray) -> None:
        """Refuse a controller that may command a γ which no rest length gives.

        Parameters
        ----------
        law : StringLaw
            Of the strings of the plant.
        most : ndarray, shape (α,)
            Largest γ commanded, N/m.
        """
        largest, limit = self.spread_force_density(most), law.largest_force_density
        segments = self.spread_force_density(np.ones(self.count))
        over = np.flatnonzero(largest >= limit)
        if len(over):
            i = over[0]
            raise ValueError(
                f"the controller may command γ = {largest[i]:g} N/m on string {i}, but a string of "
                f"stiffness {limit[i]:g} N/m stays below that whatever its rest length. Give the "
                f"controller max_force_density below {limit[i] / segments[i]:g}"
            )
