"""Least mass over a family of structures that carry the same load."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.interrupt import check, interruptible
from tenscontrol.sizing.minimal_mass import Design
from tenscontrol.structure.structure import Structure
from tenscontrol.tables import aligned


@dataclass(frozen=True, eq=False, repr=False)
class Complexity:
    """Designs of a family of structures. Made by :func:`complexity`.

    Attributes
    ----------
    labels : tuple
        What tells the structures apart, such as the number of stages, in the order given.
    designs : tuple of Design
        The design of each.
    """

    labels: tuple[object, ...]
    designs: tuple[Design, ...]

    @property
    def mass(self) -> FloatArray:
        """Mass of each design, kg, shape (k,)."""
        return frozen(np.array([sized.mass for sized in self.designs]))

    @property
    def lightest(self) -> object:
        """The label of the lightest design."""
        return self.labels[int(self.mass.argmin())]

    def table(self) -> str:
        """Return structures with their members, masses, how many bars buckling sizes, and gap."""
        rows = [
            [str(label), str(len(sized.structure.bars)), str(len(sized.structure.strings)),
             f"{sized.bar_mass.sum():.4g}", f"{sized.string_mass.sum():.4g}", f"{sized.mass:.4g}",
             str(sized.bar_limit.count("buckling")), f"{100 * sized.gap:.2g}"]
            for label, sized in zip(self.labels, self.designs, strict=True)
        ]  # fmt: skip
        names = ["structure", "bars", "strings", "bars kg", "strings kg", "mass kg", "buckling"]
        return aligned([*names, "gap %"], rows)

    def __repr__(self) -> str:
        return (
            f"Complexity({len(self.designs)} designs, {self.mass.min():.4g} to "
            f"{self.mass.max():.4g} kg, lightest {self.lightest!r})"
        )


def complexity(
    family: Mapping[Any, Structure], sized: Callable[[Structure], Design]
) -> Complexity:  # fmt: skip
    """Return the design of least mass of each structure of a family.

    Parameters
    ----------
    family : mapping of a label to Structure
        Structures that do the same: towers of one height by their number of stages.
    sized : callable
        Takes a structure and returns its design, by :func:`design` under its loads.

    Returns
    -------
    Complexity

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or a structure cannot carry its loads: the message names it.

    Examples
    --------
    A column of more stages weighs less:

    >>> import numpy as np, tenscontrol as tc
    >>> def column(stages):
    ...     return tc.prism_tower(stages, height=10 / (0.75 * stages + 0.25))
    >>> def pressed(tower):
    ...     height = tower.nodes[2]
    ...     load = np.zeros(tower.nodes.shape)
    ...     load[2, np.argsort(height)[-3:]], load[2, np.argsort(height)[:3]] = -300.0, 300.0
    ...     return [load]
    >>> metal, rope = (tc.sizing.materials[name] for name in ("aluminium", "dyneema"))
    >>> found = tc.sizing.complexity(
    ...     {q: column(q) for q in (2, 4)},
    ...     lambda tower: tc.design(
    ...         tower, bars=metal, strings=rope, loads=pressed(tower), restarts=1))
    >>> found.lightest, [len(sized.structure.bars) for sized in found.designs]
    (4, [6, 12])
    """
    if not isinstance(family, Mapping) or not family:
        raise validation.wrong_kind("family", family, "a mapping of labels to structures")
    validation.function("sized", sized, "takes a structure and returns its Design")
    designs = []
    with interruptible():
        for label, structure in family.items():
            check()
            name = f"family[{label!r}]"
            validation.instance(name, structure, Structure, "make one by Structure(...)")
            try:
                one = sized(structure)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
            validation.instance(f"what sized returns for {name}", one, Design, "by design(...)")
            designs.append(one)
    return Complexity(tuple(family), tuple(designs))
