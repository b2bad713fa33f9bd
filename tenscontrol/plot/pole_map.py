"""Poles in the complex plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation

from tenscontrol import validation
from tenscontrol.plot.style import (
    PALETTE,
    closes_on_error,
    dress,
    flat_axes,
    legend_above,
    marker_style,
)
from tenscontrol.short_repr import short_repr

# Poles closer than this fraction of the largest are drawn as one: round-off
# splits a double pole by less.
_SAME = 1e-4

# Marker and its size, points. Poles of one set show through the markers of another.
_MARKERS = (("x", 6.5), ("o", 7.5), ("s", 6.5), ("^", 7.5), ("D", 6.0), ("+", 9.0))

# Where the centre of a number may be beside its pole, points, the best place
# first; away from the real axis is up. Then half the room that a number needs
# to keep clear of a marker and of another number.
_NEAR = [(13, 7), (13, -7), (-13, 7), (-13, -7), (0, 13), (0, -13), (17, 0), (-17, 0)]
_FAR = [(16, 15), (16, -15), (-16, 15), (-16, -15)]
_PLACES = np.array([*_NEAR, *_FAR])
_FROM_MARKER, _FROM_NUMBER = (12.0, 9.0), (19.0, 10.0)


@dataclass(frozen=True, eq=False)
class PoleMap:
    """What was drawn of poles. Made by :func:`poles`.

    Attributes
    ----------
    ax : Axes
        Where they were drawn.
    markers : dict of str to Line2D
        The poles of each set, equal ones once.
    multiplicities : dict of str to tuple of Annotation
        The numbers beside poles that a set has more than once.
    """

    ax: Axes
    markers: dict[str, Line2D]
    multiplicities: dict[str, tuple[Annotation, ...]]

    __repr__ = short_repr


@closes_on_error
def poles(poles: object, *, ax: Axes | None = None) -> PoleMap:
    """Draw poles in the complex plane, the stable half of which is shaded.

    Poles that coincide are drawn once, with their number beside them: ×3.

    Parameters
    ----------
    poles : array_like of complex, shape (k,), or mapping of str to such arrays
        Poles s of a system in continuous time, 1/s, for example ``numpy.linalg.eigvals(plant.A)``.
        Several sets, by the name that the legend shows, get different markers.
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    PoleMap

    Raises
    ------
    TypeError, ValueError
        If the poles are not complex numbers in a row, none is given, one is
        not finite, or ``ax`` is not a pair of flat axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> drawn = tc.plot.poles({"open loop": np.linalg.eigvals(plant.A)})
    >>> [text.get_text() for text in drawn.multiplicities["open loop"]]
    ['×3', '×3', '×2', '×2', '×6']
    >>> plt.close(drawn.ax.figure)
    """
    named = poles if isinstance(poles, Mapping) else {"poles": poles}
    if not named:
        raise ValueError("poles has no sets, expected at least one array of poles in 1/s")
    sets = {
        str(name): _checked(f"poles[{name!r}]" if named is poles else "poles", values)
        for name, values in named.items()
    }
    largest = max(float(np.abs(values).max()) for values in sets.values())
    ax = flat_axes(ax)
    _lay_out(ax, sets, largest)
    markers: dict[str, Line2D] = {}
    multiplicities: dict[str, tuple[Annotation, ...]] = {}
    distinct = {name: _distinct(values, _SAME * largest) for name, values in sets.items()}
    places = _NumberPlaces(ax, np.concatenate([values for values, _ in distinct.values()]))
    for position, (name, (values, counts)) in enumerate(distinct.items()):
        marker, size = _MARKERS[position % len(_MARKERS)]
        color = PALETTE[position % len(PALETTE)]
        (markers[name],) = ax.plot(
            values.real,
            values.imag,
            label=name,
            zorder=3 + 0.1 * position,
            **marker_style(marker, size, color, mfc="none", mew=1.4, clip_on=False),
        )
        multiplicities[name] = tuple(
            ax.annotate(
                f"×{count}",
                (value.real, value.imag),
                xytext=places.take(value),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize="small",
                color=color,
                zorder=4,
            )
            for value, count in zip(values, counts, strict=True)
            if count > 1
        )
    legend_above(ax)
    return PoleMap(ax, markers, multiplicities)


class _NumberPlaces:
    """Finds places for numbers beside poles, clear of the markers and of one another."""

    def __init__(self, ax: Axes, poles: np.ndarray) -> None:
        self._ax = ax
        self._markers = self._points(poles)
        self._numbers = np.zeros((0, 2))

    def _points(self, poles: np.ndarray) -> np.ndarray:
        where = self._ax.transData.transform(np.column_stack([poles.real, poles.imag]))
        return np.asarray(where * 72 / self._ax.figure.dpi)

    def take(self, pole: complex) -> tuple[float, float]:
        """Return where the number of this pole goes, points from the pole."""
        point = self._points(np.array([pole]))[0]
        up = np.where(pole.imag < 0, -1, 1)
        places = _PLACES * [1, up]
        hits = [
            10 * int((np.abs(self._numbers - point - offset) < _FROM_NUMBER).all(axis=1).sum())
            + int((np.abs(self._markers - point - offset) < _FROM_MARKER).all(axis=1).sum())
            for offset in places
        ]
        best = places[int(np.argmin(hits))]
        self._numbers = np.vstack([self._numbers, point + best])
        return float(best[0]), float(best[1])


def _lay_out(ax: Axes, sets: Mapping[str, np.ndarray], largest: float) -> None:
    """Draw the axes through zero and the stable half, with limits around all poles."""
    every = np.concatenate([*sets.values(), [0.0]])
    size = largest if largest > 0 else 1.0
    limits = []
    for values in (every.real, every.imag):
        margin = 0.1 * max(float(np.ptp(values)), 0.1 * size)
        limits.append((float(values.min()) - margin, float(values.max()) + margin))
    if ax.has_data():
        before = (ax.get_xlim(), ax.get_ylim())
        limits = [
            (min(new[0], old[0]), max(new[1], old[1]))
            for new, old in zip(limits, before, strict=True)
        ]
    style: dict[str, Any] = {"color": "0.45", "linewidth": 0.8, "zorder": 1.5}
    ax.axhline(0.0, **style)
    ax.axvline(0.0, **style)
    # Far beyond the limits, so that the shade stays when a user zooms out.
    shade = ax.axvspan(-1e3 * size, 0.0, color="0.94", linewidth=0, zorder=0)
    dress(ax, "Re s, 1/s", "Im s, 1/s")
    if not any(isinstance(handle, Patch) for handle in ax.get_legend_handles_labels()[0]):
        shade.set_label("stable")
    ax.set(xlim=limits[0], ylim=limits[1])


def _distinct(values: np.ndarray, tolerance: float) -> tuple[np.ndarray, list[int]]:
    """Return the different poles, outermost first, equal ones averaged, and how often each is."""
    groups: list[list[complex]] = []
    for value in values[np.lexsort([values.real, values.imag])]:
        near = next((group for group in groups if abs(group[0] - value) <= tolerance), None)
        if near is None:
            groups.append([value])
        else:
            near.append(value)
    means = np.array([np.mean(group) for group in groups])
    height = np.round(np.abs(means.imag) / max(tolerance, 1e-300))
    order = np.lexsort([means.real, means.imag, -height])
    return means[order], [len(groups[i]) for i in order]


def _checked(name: str, values: object) -> np.ndarray:
    try:
        with np.errstate(over="ignore"):  # of a longer kind of float: infinite
            array = np.array(values, dtype=complex)
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(
            f"{name} must be an array of complex numbers, as tc.modes(plant).pole: {error}"
        ) from None
    if array.ndim != 1 or len(array) == 0:
        raise ValueError(f"{name} has shape {array.shape}, expected (k,): one number per pole")
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise ValueError(
            f"{name}[{bad[0]}] is {array[bad[0]]}, expected a finite number in 1/s; "
            f"{len(bad)} of {len(array)} poles are not finite"
        )
    validation.float_array(name, array.view(float))
    return array
