"""Forms of the state equation for large scenes, and which form suits a scene."""

from __future__ import annotations

from tenscontrol.dynamics.forms.loops import loops_equation, loops_source
from tenscontrol.dynamics.forms.mapped import mapped_equation
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.structure import Structure

__all__ = ["LARGEST_FLAT", "loops_equation", "loops_source", "mapped_equation", "suitable_form"]

#: Bars and strings up to which every member is written out. Without a compiler, operations on all
#: members at once are as fast from 36 members on (towers of prisms, force densities or rest
#: lengths held), five times as fast from 180 on, and built in no time where 1500 written out take
#: 0.3 s. With a compiler, loops are as fast as members written out even for 12, and compile in
#: 0.3 s where 84 members written out take 4 to 13 s, 756 minutes. Below, a flat expression is
#: kept: it can be put into the expressions of a step, compiled with them, and differentiated.
LARGEST_FLAT = 40


def suitable_form(structure: Structure) -> str:
    """Return "flat", "mapped" or "loops", by the number of members and whether C compiles here."""
    if len(structure.bars) + len(structure.strings) <= LARGEST_FLAT:
        return "flat"
    return "mapped" if compiler() is None else "loops"
