"""Mode shapes of a linear plant, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.modes import Modes
from tenscontrol.plot.structure_drawing import (
    Drawing,
    draw,
    draw_arrows,
    frame,
    known_actuation,
    new_view,
    passive_strings,
)
from tenscontrol.plot.style import (
    SMALL,
    SMALL_FAINT,
    checked_indices,
    closes_on_error,
    given_axes,
)
from tenscontrol.short_repr import short_repr

_COLUMNS = 3
_MOST = 9  # modes shown unless the user says which
_PANEL = 2.5  # inches, the larger side of a panel
_NARROWEST = 0.6  # the smaller one, as part of it
_GAP = 0.12  # between a drawing and its title, inches
_TITLE = 0.45 + _GAP  # above a panel, inches

# Nodes that move less than this part of the largest displacement have no arrow.
_STILL = 0.15


@dataclass(frozen=True, eq=False)
class ModeShape:
    """What was drawn of one mode. Made by :func:`mode_shapes`.

    Attributes
    ----------
    mode : int
        Its number in ``modes``.
    reference : Drawing
        The shape at the operating point, in grey.
    displaced : Drawing
        The shape displaced along the mode.
    arrows : Line3DCollection or Quiver
        From where a node is to where it is displaced; none for nodes that hardly move,
        and for at most 24 nodes.
    """

    mode: int
    reference: Drawing
    displaced: Drawing
    arrows: Any

    __repr__ = short_repr

    @property
    def ax(self) -> Any:
        """The axes of the panel."""
        return self.displaced.ax


@closes_on_error
def mode_shapes(
    plant: LinearPlant,
    modes: Modes,
    which: Sequence[int] | None = None,
    *,
    scale: float = 0.2,
    axes: Sequence[Any] | None = None,
) -> tuple[ModeShape, ...]:
    """Draw mode shapes side by side, each over the reference shape in grey, with arrows.

    A mode has no size of its own: the displacements are exaggerated, and along straight lines, so
    that bars look longer than they are. All panels have one scale; axes are left out for that.

    Parameters
    ----------
    plant : LinearPlant
        Gives the structure and the shape at the operating point.
    modes : Modes
        Modes of this plant, or those that a controller leaves alone: ``controller.left_alone``.
    which : sequence of int, optional
        Numbers of the modes to draw; the first nine if not given.
    scale : float
        Largest node displacement over the size of the structure (its largest
        extent along x, y or z).
    axes : sequence of Axes3D or Axes, optional
        Where to draw, one for each mode, flat for a structure in the plane; a new figure if not
        given.

    Returns
    -------
    tuple of ModeShape

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, there is no such
        mode, or the modes belong to another structure.

    Notes
    -----
    A complex shape, of a damped mode whose nodes move out of step, is drawn at
    the phase at which its real part is largest.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> (drawn,) = tc.plot.mode_shapes(plant, tc.modes(plant), which=[5])
    >>> print(drawn.ax.get_title())
    mode 5: 1.775 Hz
    mechanism
    >>> plt.close(drawn.ax.figure)
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    validation.instance("modes", modes, Modes, "make them by modes(plant)")
    structure, nodes = plant.model.structure, plant.nodes
    passive = passive_strings(structure, known_actuation(plant))
    if modes.shape.shape[:2] != nodes.shape:
        raise ValueError(
            f"modes.shape has shape {modes.shape.shape}, expected {nodes.shape} and one more: "
            "give the plant from which the modes were computed"
        )
    count = len(modes.label)
    if not count:
        raise ValueError("modes holds no mode, so there is nothing to draw")
    chosen = list(range(min(count, _MOST)))
    if which is not None:
        chosen = checked_indices("which", which, count, "mode numbers", "[0, 5]")
    share = validation.positive_number("scale", scale, "structure sizes")
    size = float(share * np.ptp(nodes, axis=1).max())
    moved = [nodes + size * _at_largest(modes.shape[:, :, mode]) for mode in chosen]
    panels, top = _panels(axes, len(chosen), np.concatenate([nodes, *moved], axis=1))
    drawn = []
    for ax, mode, displaced in zip(panels, chosen, moved, strict=True):
        shape = ModeShape(
            mode,
            reference=draw(ax, structure, nodes, SMALL_FAINT),
            displaced=draw(ax, structure, displaced, SMALL, passive),
            arrows=draw_arrows(ax, nodes, displaced - nodes, _STILL * size),
        )
        frame(ax, [nodes, *moved], grow=False, fill=0.8)
        ax.set_axis_off()
        title = f"mode {mode}: {_rate(modes, mode)}\n{modes.label[mode]}"
        ax.set_title(title, fontsize="small", y=top)
        drawn.append(shape)
    return tuple(drawn)


def _rate(modes: Modes, mode: int) -> str:
    """Return the frequency of a mode, or the rate at which one grows that runs away."""
    if modes.damping[mode] <= -1:
        return f"grows, {modes.pole[mode].real:#.4g} 1/s"
    return f"{modes.frequency[mode]:#.4g} Hz" if modes.frequency[mode] > 0 else "0 Hz"


def _panels(axes: Sequence[Any] | None, count: int, drawn: FloatArray) -> tuple[list[Any], float]:
    """Return axes that hold points (d, n), and the height of titles as part of that of the axes."""
    dimension = len(drawn)
    if axes is not None:
        kind = "three-dimensional" if dimension == 3 else "flat"
        return given_axes(axes, count, "one for each mode drawn", kind), 0.97
    # Tall structures stand close together, flat ones have little height. Axes are square and may
    # overlap: nothing is drawn in them but the structure.
    extent = np.ptp(drawn, axis=1)
    shape = np.array([np.linalg.norm(extent[:-1]), extent[-1]])
    wide, high = np.maximum(shape / shape.max(), _NARROWEST) * _PANEL
    columns = min(count, _COLUMNS)
    rows = ceil(count / columns)
    width, height = max(wide * columns, _PANEL), (high + _TITLE) * rows
    figure = plt.figure(figsize=(width, height))
    panels = []
    for i in range(count):
        row, column = divmod(i, columns)
        x, y = (column + 0.5) * width / columns, height - (row + 1) * (high + _TITLE) + high / 2
        ax = new_view(figure, dimension, rows, columns, i + 1)
        corner = np.array([x, y]) - _PANEL / 2
        ax.patch.set_visible(False)
        ax.set_position((*corner / (width, height), _PANEL / width, _PANEL / height))
        panels.append(ax)
    return panels, 0.5 + (0.5 * high + _GAP) / _PANEL


def _at_largest(shape: np.ndarray) -> FloatArray:
    """Return a shape (d, n) at the phase at which its real part is largest, scaled to 1."""
    phase = 0.5 * np.angle((shape**2).sum())
    real = (shape * np.exp(-1j * phase)).real
    return np.asarray(real / np.linalg.norm(real, axis=0).max())
