"""Margins of strength of the members along a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.properties import cached_property
from tenscontrol.simulation.motion_functions import distances
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.structure import Structure
from tenscontrol.tables import aligned

if TYPE_CHECKING:
    from tenscontrol.sizing.sections import Sections

# Margins that differ by less than this part are the same.
_SAME = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class Strength:
    """How many times its force each member could carry over a run. Made by :func:`strength`.

    Attributes
    ----------
    run : Trajectory
    sections : Sections
    string_margin : ndarray, shape (α, T)
        Strength over tension at the times of the run; infinite without force.
    bar_margin : ndarray, shape (β, T)
        The less of yield and, in compression, Euler's load, over the force.
    """

    run: Trajectory
    sections: Sections
    string_margin: FloatArray
    bar_margin: FloatArray

    @cached_property
    def least(self) -> FloatArray:
        """Least margin of each member, strings first, shape (α + β,)."""
        return frozen(self._all.min(axis=1))

    @cached_property
    def when(self) -> FloatArray:
        """Time at which each member first has its least margin, s, shape (α + β,)."""
        return frozen(self.run.time[self._worst])

    @property
    def margin(self) -> float:
        """Least margin of all members; at least 1 where nothing yields and nothing buckles."""
        return float(self.least.min(initial=np.inf))

    @cached_property
    def limit(self) -> tuple[str, ...]:
        """What each member comes nearest to, "yield" or "buckling", strings first."""
        sized, alpha = self.sections, len(self.string_margin)
        worst = self._worst[alpha:]
        force = np.take_along_axis(self.run.bar_force_density, worst[:, None], axis=1)[:, 0]
        is_weak = sized.buckling_force < sized.bar_stress * sized.bar_area
        buckles = (force > 0) & is_weak
        return ("yield",) * alpha + tuple("buckling" if buckled else "yield" for buckled in buckles)

    def failure(self, margin: float = 1.0) -> str | None:
        """Return the sentence on the first member whose margin falls below one; None if none does.

        Parameters
        ----------
        margin : float
            Times its force that each member is to carry.
        """
        margin = validation.positive_number("margin", margin, "times the force")
        below = self._all < margin * (1 - _SAME)
        weak = np.flatnonzero(below.any(axis=1))
        if not len(weak):
            return None
        first = below[weak].argmax(axis=1)
        soonest = np.flatnonzero(first == first.min())
        i = int(weak[soonest[self.least[weak[soonest]].argmin()]])
        time, least = self.run.time[first.min()], self.least[i]
        more = len(weak) - 1
        others = f", and {more} more member{'s' * (more > 1)} fall{'s' * (more == 1)} below" * (
            more > 0
        )
        return (
            f"the margin of {self.limit[i]} of {self._name(i)} falls below {margin:g} at "
            f"{time:.4g} s, to {least:.3g} at {self.when[i]:.4g} s{others}. Give larger sections, "
            "or hold other inputs; strength(run, sections) says more"
        )

    def table(self) -> str:
        """Return the members as text, those of the least margin first."""
        rows = []
        for i in np.argsort(self.least, kind="stable"):
            rows.append(
                [self._name(i), f"{self.least[i]:.4g}", f"{self.when[i]:.4g}", self.limit[i]]
            )
        return aligned(["member", "margin", "time s", "limit"], rows)

    @property
    def _all(self) -> FloatArray:
        return np.vstack([self.string_margin, self.bar_margin])

    @property
    def _worst(self) -> IntArray:
        """Which time is the first at which each member has its least margin, but for round-off."""
        return np.asarray((self._all <= self.least[:, None] * (1 + _SAME)).argmax(axis=1))

    def __repr__(self) -> str:
        if not len(self.least):
            return "Strength(no members)"
        i = int(self.least.argmin())
        when, limit = self.when[i], self.limit[i]
        return f"Strength({self.margin:.4g} at {when:.4g} s, {limit} of {self._name(i)})"

    def _name(self, i: int) -> str:
        alpha = len(self.string_margin)
        return f"string {i}" if i < alpha else f"bar {i - alpha}"


def strength(run: Trajectory, sections: Sections) -> Strength:
    """Return the margin of each member over a run: how many times its force it could carry.

    Parameters
    ----------
    run : Trajectory
        Made by :func:`simulate`. Margins are those of its times: give outputs close enough to see
        the peaks.
    sections : Sections
        Of the same members, made by :func:`sections` or :func:`design`.

    Returns
    -------
    Strength

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, members differ, or the bars' forces are not known:
        of a run with moving supports, or a copy without its model.

    Notes
    -----
    A member is taken to bear its force as if it stayed. Buckling takes longer than a short shock,
    so that peaks of a shock are on the safe side. Bending of bars by their own inertia and weight
    is left out.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> metal = tc.sizing.materials["aluminium"]
    >>> sized = tc.sections(tc.prism(), bars=metal, bar_radius=[0.005, 0.006, 0.006],
    ...                     strings=metal, string_radius=0.001)
    >>> rest = tc.prestress(sized.structure, force_density=1000.0)
    >>> run = tc.simulate(tc.Model(sized.structure), 0.1, force_density=rest.force_density)
    >>> tc.strength(run, sized)
    Strength(0.07171 at 0 s, buckling of bar 0)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    from tenscontrol.sizing.sections import Sections

    validation.instance("sections", sections, Sections, "make one by sections(...) or design(...)")
    refuse_other_members(run.structure, sections)
    if run.struts is not None:
        raise ValueError(
            "run has driven bars, and sections buckle as bars of constant length do: compare "
            "run.struts.force with the buckling force at run.struts.length"
        )
    length = distances(run.nodes, run.structure.bars)
    margins = sections.margins(run.tension, run.bar_force_density * length)
    return Strength(run, sections, *(frozen(margin) for margin in margins))


def refuse_other_members(structure: Structure, sections: Sections) -> None:
    """Raise where sections are not of the members of a structure."""
    for name in ("strings", "bars"):
        own, given = (getattr(source, name) for source in (structure, sections.structure))
        if not np.array_equal(own, given):
            raise ValueError(
                f"sections are of other {name} than the run: {len(given)} against {len(own)}; "
                "simulate sections.structure, or make sections of run.structure"
            )
