"""Colours, line styles and line widths: one look for every figure.

Nothing depends on colour alone. Curves differ in their dashes too, bars and
strings in their width and in how dark they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap

# Okabe & Ito (2008), without the yellow, which is lost on white paper.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")

# Five dashes and seven colours: 35 curves before a pair comes again.
DASHES: tuple[Any, ...] = (
    "solid",
    (0, (6, 2)),
    (0, (1.5, 1.5)),
    (0, (6, 2, 1.5, 2)),
    (0, (6, 1.5, 1.5, 1.5, 1.5, 1.5)),
)
DOTTED: Any = (0, (1.0, 2.2))

CURVE_WIDTH = 1.3
REFERENCE_COLOR = "0.35"
REFERENCE_WIDTH = 1.0
GRID = MappingProxyType({"color": "0.9", "linewidth": 0.6})

# Force densities: light is little, dark is much, in grey print too. The lightest
# part of the map is left out: it is lost on white paper.
FORCE_MAP = ListedColormap(colormaps["cividis"](np.linspace(0.85, 0.0, 256)), name="force")
FORCE_WIDTH = 1.4  # of the usual width of strings

# Up to so many members are drawn at full width; many more at least at this share of it.
_FEW, _THINNEST = 30, 0.4


@dataclass(frozen=True)
class MemberStyle:
    """How the members of a structure are drawn; widths and sizes in points."""

    bar_color: str
    bar_width: float
    string_color: str
    string_width: float
    node_color: str
    node_size: float
    layer: float

    def fitted(self, members: int) -> MemberStyle:
        """Return the style for a structure of so many members: thinner where there are many."""
        share = min(1.0, max(_THINNEST, (_FEW / max(members, 1)) ** 0.5))
        return replace(
            self,
            bar_width=share * self.bar_width,
            string_width=share * self.string_width,
            node_size=share * self.node_size,
        )


NORMAL = MemberStyle("0.15", 4.0, PALETTE[0], 1.2, "0.15", 5.0, 4.0)
FAINT = MemberStyle("0.82", 3.5, "0.72", 0.9, "0.82", 4.0, 1.0)


# Beside one another, smaller.
SMALL = MemberStyle("0.15", 2.6, PALETTE[0], 0.9, "0.15", 3.2, 4.0)
SMALL_FAINT = MemberStyle("0.82", 2.4, "0.72", 0.7, "0.82", 2.6, 1.0)


def curve_style(position: int) -> dict[str, Any]:
    """Return colour, dashes and width of the curve at this position in a figure."""
    return {
        "color": PALETTE[position % len(PALETTE)],
        "linestyle": DASHES[position % len(DASHES)],
        "linewidth": CURVE_WIDTH,
    }


def reference_style(position: int) -> dict[str, Any]:
    """Return colour, dashes and width of the reference line at this position."""
    return {
        "color": REFERENCE_COLOR,
        "linestyle": DASHES[(position + 1) % len(DASHES)],
        "linewidth": REFERENCE_WIDTH,
    }
