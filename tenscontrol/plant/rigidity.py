"""Elasticity of bars beside the modes of a plant with rigid ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.tangent import tangent
from tenscontrol.plant.linear_plant import LinearPlant, squared_frequencies
from tenscontrol.plant.linearize import in_coordinates
from tenscontrol.plant.string_outputs import to_model_strings
from tenscontrol.structure.blocks import bar_rows
from tenscontrol.structure.structure import Structure
from tenscontrol.tables import aligned, percent
from tenscontrol.warn import warn

# Changes beyond matter, and so do frequencies above this part of the lowest of the bars.
_MATTERS, _NEAR = 0.01, 1 / 3

# Squared frequencies below this part of the largest are zero.
_STILL = 1e-9


class RigidityWarning(UserWarning):
    """Bars that are taken as rigid, where their elasticity matters."""


@dataclass(frozen=True, eq=False, repr=False)
class Rigidity:
    """How far elastic bars would change modes with rigid ones. Made by :func:`rigidity`.

    Attributes
    ----------
    axial_frequency : ndarray, shape (β,)
        Lowest frequency of each bar along itself, with what is fixed to its ends, Hz.
    frequency : ndarray, shape (k,)
        Of the modes with rigid bars and without damping, Hz, ascending; those at zero are left out.
        Unstable ones come first, the fastest before all, with 0.
    growth_rate : ndarray, shape (k,)
        Rate at which unstable modes grow, 1/s; 0 where a mode vibrates.
    change : ndarray, shape (k,)
        What elastic bars change of each frequency, to first order, as part of it: negative. Of an
        unstable mode, what they change of its growth rate: positive.
    bar : ndarray of int, shape (k,)
        The bar that has the largest part in it.
    """

    axial_frequency: FloatArray
    frequency: FloatArray
    growth_rate: FloatArray
    change: FloatArray
    bar: IntArray

    def table(self) -> str:
        """Return the modes as text, with what elastic bars change of each."""
        rows = [
            [str(i), f"{frequency:.5g}", f"{rate:.5g}", percent(change, 3), str(bar)]
            for i, (frequency, rate, change, bar) in enumerate(
                zip(self.frequency, self.growth_rate, self.change, self.bar, strict=True)
            )
        ]
        lowest = float(self.axial_frequency.min(initial=np.inf))
        title = f"lowest frequency of a bar along itself: {lowest:.5g} Hz"
        names = ["mode", "rigid bars Hz", "grows 1/s", "change", "most by bar"]
        return title + "\n" + aligned(names, rows)

    def __repr__(self) -> str:
        if not len(self.change):
            return "Rigidity(no modes)"
        most = float(self.change[np.abs(self.change).argmax()])
        lowest = self.axial_frequency.min()
        return (
            f"Rigidity({len(self.change)} modes, {percent(most)} at most, "
            f"bars from {lowest:.4g} Hz)"
        )


def rigidity(plant: LinearPlant, axial_rigidity: object, count: int | None = None) -> Rigidity:
    """Return how far elastic bars would change the modes of a plant.

    Bars are rigid in this package. That holds for modes far below the axial vibrations of bars. The
    result says by how much each mode would change.

    Parameters
    ----------
    plant : LinearPlant
    axial_rigidity : float or array_like, shape (β,)
        E A of each bar, N: :attr:`~tenscontrol.sizing.Sections.bar_axial_rigidity` of sections.
    count : int, optional
        How many modes, the lowest; all if not given.

    Returns
    -------
    Rigidity

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or there are no bars.

    Warns
    -----
    RigidityWarning
        If a mode changes by more than 1 %, or lies above a third of the lowest frequency of a bar
        along itself.

    Notes
    -----
    In a mode φ with frequency ω the bars bear forces f, which ``K φ − ω² M φ = Jᵀ f`` gives. They
    lengthen by ``f l/EA``, which changes the frequency by ``−½ Σ f² l/EA / (ω² φᵀ M φ)`` of itself,
    to first order. An unstable mode has ω² below 0 and grows faster. Mass is spread evenly along a
    bar, and only its ends move freely, as in a finite element of two nodes. Where more bars meet
    than lengths are independent, the forces are those of the independent ones.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> metal = tc.sizing.materials["aluminium"]
    >>> sized = tc.sections(tc.prism(), bars=metal, bar_radius=0.01, strings=metal,
    ...                     string_radius=0.001)
    >>> model = tc.Model(sized.structure, strings=tc.LinearStrings(2e4))
    >>> rest = tc.prestress(sized.structure, force_density=100.0)
    >>> plant = tc.linearize(model, rest, input="rest_length")
    >>> tc.rigidity(plant, sized.bar_axial_rigidity)
    Rigidity(9 modes, -0.015 % at most, bars from 2003 Hz)
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    structure = plant.model.structure
    bars = len(structure.bars)
    if not bars:
        raise ValueError("plant has no bars that could be elastic")
    stiffness = validation.per_member("axial_rigidity", axial_rigidity, bars, "bar")
    stiffness = validation.positive("axial_rigidity", stiffness, "force in N")
    if count is not None:
        count = validation.whole_number("count", count, 1)
    if plant.coordinates.kind == "nodes":
        plant = in_coordinates(plant, "minimal")
    r = plant.degrees_of_freedom
    squares, vectors = squared_frequencies(-plant.A[r:, :r])
    moves = np.abs(squares) > _STILL * np.abs(squares).max(initial=0.0)
    order = np.argsort(squares[moves], kind="stable")[:count]
    squares, vectors = squares[moves][order], vectors[:, moves][:, order]
    lengthened = _lengthened(plant, squares, vectors, stiffness)
    result = Rigidity(
        frozen(_axial_frequencies(structure, stiffness)),
        frozen(np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)),
        frozen(np.sqrt(np.maximum(-squares, 0.0))),
        frozen(-0.5 * lengthened.sum(axis=0) / squares),
        frozen(lengthened.argmax(axis=0)),
    )
    _warn(result)
    return result


def _lengthened(
    plant: LinearPlant, squares: FloatArray, vectors: FloatArray, stiffness: FloatArray
) -> FloatArray:
    """Return f² l/EA of each bar in modes of mass 1, (rad/s)², shape (β, k)."""
    from scipy.sparse.linalg import splu

    model, structure, nodes = plant.model, plant.model.structure, plant.nodes
    held = plant.force_density if plant.input == "force_density" else plant.rest_length
    assert held is not None  # it is the input
    held = to_model_strings(plant, plant.string_input, held)
    here = tangent(model, nodes, plant.string_input, held, plant.external_force)
    free, bars = structure.free_rows, structure.kept_bars
    moved = np.asarray(plant.coordinates.displacements(vectors))
    mass = here.mass @ moved
    moved = moved / np.sqrt((moved * mass).sum(axis=0))
    unbalanced = (here.stiffness @ moved - squares * (here.mass @ moved))[free]
    J = bar_rows(structure, bars, nodes)[:, free].tocsc()
    density = splu((J @ J.T).tocsc()).solve(np.asarray(J @ unbalanced))
    length = structure.bar_length
    squared = np.zeros((len(structure.bars), len(squares)))
    squared[bars] = (density * length[bars, None]) ** 2
    return squared * (length / stiffness)[:, None]


def _axial_frequencies(structure: Structure, stiffness: FloatArray) -> FloatArray:
    """Return the lowest frequency of each bar along itself, Hz, with the masses at its ends."""
    spring, mass = stiffness / structure.bar_length, structure.bar_mass
    ends = structure.bars.T
    one, other = mass / 3 + structure.point_mass[ends]
    is_held = np.isin(ends, structure.fixed)
    # Of [[one, m/6], [m/6, other]] and a spring between: the frequency of the free pair, or of the
    # end that is not held.
    between = mass / 6
    pair = spring * (one + other + 2 * between) / (one * other - between**2)
    alone = spring / np.where(is_held[0], other, one)
    squares = np.where(is_held.any(axis=0), alone, pair)
    return np.asarray(np.sqrt(squares) / (2 * np.pi))


def _warn(result: Rigidity) -> None:
    lowest = float(result.axial_frequency.min())
    near = np.flatnonzero((np.abs(result.change) > _MATTERS) | (result.frequency > _NEAR * lowest))
    if len(near):
        i = int(near[0])
        rate = result.growth_rate[i]
        where = f"which grows at {rate:.4g}/s" if rate else f"at {result.frequency[i]:.4g} Hz"
        warn(
            f"elastic bars change mode {i}, {where}, by "
            f"{percent(result.change[i])}; bars vibrate along themselves from {lowest:.4g} Hz. "
            "Rigid bars are right below that mode",
            RigidityWarning,
        )
