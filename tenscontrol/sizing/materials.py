"""Materials of members."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from tenscontrol import validation


@dataclass(frozen=True)
class Material:
    """What a member is made of.

    Parameters
    ----------
    modulus : float
        Young's modulus E, Pa.
    density : float
        Mass per volume ρ, kg/m³.
    yield_stress : float
        The stress that a member may reach, in tension and in compression, Pa.

    Raises
    ------
    TypeError, ValueError
        If a value is not a positive number.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.Material(modulus=60e9, density=2700, yield_stress=110e6)
    Material(modulus=60000000000.0, density=2700.0, yield_stress=110000000.0)
    """

    modulus: float
    density: float
    yield_stress: float

    def __post_init__(self) -> None:
        for name, unit in (("modulus", "Pa"), ("density", "kg/m³"), ("yield_stress", "Pa")):
            value = validation.positive_number(name, getattr(self, name), unit)
            object.__setattr__(self, name, value)


#: Typical values, to begin with; a design that is built takes those of its supplier. Aluminium is
#: 6061-T6 (MMPDS), steel S355 (EN 1993-1-1), a carbon tube unidirectional with epoxy in compression
#: (Performance Composites Ltd., standard fibre), nylon dry PA 66, Dyneema the fibre SK75 (van der
#: Werff & Pennings 1991; a rope of it has about half), wire rope 7×19 of grade 1770 by the area of
#: its metal (EN 12385).
materials = MappingProxyType(
    {
        "aluminium": Material(68.9e9, 2700, 276e6),
        "steel": Material(210e9, 7850, 355e6),
        "carbon tube": Material(135e9, 1600, 1200e6),
        "nylon": Material(2.7e9, 1140, 80e6),
        "dyneema": Material(109e9, 970, 3.4e9),
        "wire rope": Material(100e9, 7850, 1770e6),
    }
)
