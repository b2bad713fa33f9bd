"""The shapes that a controller follows, with the input that holds each of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np

from tenscontrol.dynamics import evaluate_columns
from tenscontrol.plant import LinearPlant
from tenscontrol.plant.reference import ReducedReference, Reference
from tenscontrol.plant.string_outputs import gather_lengths, spread
from tenscontrol.validation import FloatArray, float_array, frozen

# Force densities of a reference shape may leave those of the operating point only as far as the
# balance of forces gains from it, by this fraction of the largest singular value.
_RIDGE = 1e-3

# A string can be wound up to this fraction of what its law allows.
_STRONGEST = 0.99


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a path, at K moments.

    Attributes
    ----------
    rest : ndarray, shape (K, s)
        Where the plant would rest, ``[q; 0]``.
    input : ndarray, shape (K, α)
        The input that holds it there: origin of v.
    force_density : ndarray, shape (K, α')
        γ of the strings of the model there, N/m.
    tension : ndarray, shape (K, α')
        N.
    drift : ndarray, shape (K, s)
        What the state drifts away in a sample all the same.
    """

    rest: FloatArray
    input: FloatArray
    force_density: FloatArray
    tension: FloatArray
    drift: FloatArray


class Path:
    """A reference in the coordinates of a plant, and what holds the plant on it.

    Where γ is the input, the plant is linear about its operating point all along. Where the
    rest length is, the strings' lengths in the shapes themselves are used: a stiff string
    forgives no second-order error of its length.

    Parameters
    ----------
    plant : LinearPlant
    reference : Reference or array_like, shape (3, n), or None
        The operating point for None.
    sample_time : float
        Sample time, s.
    push : ndarray, shape (s, r)
        What unit accelerations do to the state in a sample.
    drift : ndarray, shape (s,)
        Drift of the plant at its operating point over a sample.

    Attributes
    ----------
    span : tuple of float
        First and last time of the reference, s: beyond them nothing moves.

    Raises
    ------
    TypeError, ValueError
        If the reference does not fit the structure.
    """

    def __init__(
        self,
        plant: LinearPlant,
        reference: object,
        sample_time: float,
        push: FloatArray,
        drift: FloatArray,
    ) -> None:
        reference = checked_reference(plant, reference)
        still = np.zeros_like(plant.nodes)
        r = plant.degrees_of_freedom
        shapes = [reference.nodes[:, :, k] for k in range(len(reference.time))]
        q = np.array([plant.measure(N, still)[:r] for N in shapes])
        self._reference = ReducedReference(reference.time, q)
        self._plant, self._sample_time, self._push, self._drift = plant, sample_time, push, drift
        self.span = float(reference.time[0]), float(reference.time[-1])
        self._time: FloatArray | None = None
        if plant.input == "rest_length":
            self._time = _refined(reference.time, sample_time)
            rests = self._reference.at(self._time)[:, :r]
            gamma = plant.force_density[:, None] * np.ones(len(self._time))
            if reference.force_density is not None:
                gamma = np.array(
                    [np.interp(self._time, reference.time, row) for row in reference.force_density]
                )
            self._table = _held(plant, rests, gamma, push)

    def following(self, reference: object) -> Path:
        """Return the path of another reference, given as to the constructor."""
        return Path(self._plant, reference, self._sample_time, self._push, self._drift)

    def wanted(self, times: FloatArray) -> FloatArray:
        """Return ``[q; q̇]`` of the reference, shape (K, s)."""
        return self._reference.at(times)

    def aims(self, times: FloatArray, ramp: bool) -> tuple[FloatArray, FloatArray]:
        """Return what N samples aim at: ``[q; q̇]`` at their ends, shape (N, s), and inputs (N, α).

        Inputs are those of the starts of samples. Winches that wind reach them at the ends, and
        speeds are means over two samples then: between its shapes a reference is straight, and
        stiff strings would have to follow its jumps of speed.

        Parameters
        ----------
        times : ndarray, shape (N + 1,)
            Of the starts of the samples, and the end of the last, s.
        ramp : bool
        """
        if not ramp:
            return self.wanted(times[1:]), self.at(times[:-1]).input
        sample_time = times[1] - times[0]
        q = self.wanted(np.append(times, times[-1] + sample_time))[
            :, : self._plant.degrees_of_freedom
        ]
        return np.hstack([q[1:-1], (q[2:] - q[:-2]) / (2 * sample_time)]), self.at(times[1:]).input

    def at(self, times: FloatArray) -> Stretch:
        """Return the stretch of the path at these times, shape (K,), s."""
        plant, count = self._plant, len(times)
        if self._time is None:
            gamma = spread(plant, "force_density", plant.force_density)
            tension = gamma * plant.model.structure.string_length(plant.nodes)
            still = np.zeros(len(plant.A))
            row = np.concatenate([still, plant.force_density, gamma, tension, self._drift])
            return _stretch(plant, np.tile(row, (count, 1)))
        right = np.clip(np.searchsorted(self._time, times), 1, max(1, len(self._time) - 1))
        if len(self._time) == 1:
            rows = np.tile(self._table, (count, 1))
        else:
            left, end = self._time[right - 1], self._time[right]
            share = np.clip((times - left) / (end - left), 0.0, 1.0)[:, None]
            rows = (1 - share) * self._table[right - 1] + share * self._table[right]
        return _stretch(plant, rows)


def _stretch(plant: LinearPlant, rows: FloatArray) -> Stretch:
    s, a = plant.B.shape
    strings = len(plant.model.structure.strings)
    ends = np.cumsum([s, a, strings, strings])
    rest, held, gamma, tension, drift = np.split(rows, ends, axis=1)
    return Stretch(rest, held, gamma, tension, drift)


def checked_reference(plant: LinearPlant, reference: object) -> Reference:
    """Return a reference for a plant, or raise naming it; the operating point for None."""
    shape = plant.nodes.shape
    if reference is None:
        reference = plant.nodes
    if not isinstance(reference, Reference):
        nodes = float_array("reference", reference)
        if nodes.shape != shape:
            raise ValueError(
                f"reference has shape {nodes.shape}, expected {shape}: one column per node; "
                "shapes over time go in a Reference(time, nodes)"
            )
        reference = Reference([0.0], nodes[:, :, None])
    if reference.nodes.shape[:2] != shape:
        raise ValueError(
            f"reference.nodes has shape {reference.nodes.shape}, "
            f"expected {(*shape, len(reference.time))}: one column per node"
        )
    count, gamma = plant.B.shape[1], reference.force_density
    if gamma is not None and len(gamma) != count:
        raise ValueError(
            f"reference.force_density has shape {gamma.shape}, expected "
            f"({count}, {len(reference.time)}): one row per string"
        )
    return reference


def checked_tracked(plant: LinearPlant, tracked: object) -> FloatArray:
    """Return combinations of node positions, shape (p, 3n), or raise naming the argument."""
    matrix = float_array("tracked", tracked)
    if matrix.ndim != 2 or matrix.shape[1] != plant.nodes.size or not len(matrix):
        raise ValueError(
            f"tracked has shape {matrix.shape}, expected (p, {plant.nodes.size}): "
            "one column per coordinate of a node"
        )
    return matrix


def acceleration_response(plant: LinearPlant, sample_time: float) -> FloatArray:
    """Return what unit accelerations, held over a sample, do to the state, shape (s, r).

    Parameters
    ----------
    plant : LinearPlant
    sample_time : float
        s.
    """
    r = plant.degrees_of_freedom
    pushed = replace(plant, B=np.vstack([np.zeros((r, r)), np.eye(r)]))
    return frozen(pushed.discretize(sample_time)[1])


def _refined(time: FloatArray, sample_time: float) -> FloatArray:
    """Return times with no gap above a sample."""
    parts = [
        np.linspace(start, end, max(1, int(np.ceil((end - start) / sample_time))), endpoint=False)
        for start, end in pairwise(time)
    ]
    return np.concatenate([*parts, time[-1:]])


def _held(plant: LinearPlant, q: FloatArray, wanted: FloatArray, push: FloatArray) -> FloatArray:
    """Return rest, input, γ, tension and drift of each shape, side by side, shape (K, ·).

    γ is the wanted one, shape (α, K), changed as little as the balance of forces asks for; what
    cannot be balanced shows as drift.
    """
    structure, law = plant.model.structure, plant.model.strings
    assert law is not None  # the rest length is the input
    shapes = np.array([plant.to_nodes(each) for each in q])
    offset, slope = _accelerations(plant, shapes)
    chosen = np.array([spread(plant, "force_density", column) for column in wanted.T])
    left = offset + (slope @ chosen[..., None])[..., 0]
    # Ridge regression from the operating point, shape by shape.
    U, sizes, Vt = np.linalg.svd(slope, full_matrices=False)
    floor = _RIDGE * sizes[:, :1]
    gain = sizes / (sizes**2 + floor**2)
    along = gain * (U.swapaxes(1, 2) @ left[..., None])[..., 0]
    gamma = chosen - (Vt.swapaxes(1, 2) @ along[..., None])[..., 0]
    gamma = np.clip(gamma, 0.0, _STRONGEST * law.largest_force_density)
    left = offset + (slope @ gamma[..., None])[..., 0]
    lengths = np.array([structure.string_length(N) for N in shapes])
    rest_length = np.array(
        [law.rest_length(length, each) for length, each in zip(lengths, gamma, strict=True)]
    )
    rests = np.hstack([q, np.zeros_like(q)])
    wound = gather_lengths(plant, rest_length)
    return np.hstack([rests, wound, gamma, gamma * lengths, left @ push.T])


def _accelerations(plant: LinearPlant, shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return q̈ at zero γ, shape (K, r), and its derivative by γ, (K, r, α'), at rest in shapes."""
    model = plant.model
    free = model.structure.free
    N, gamma = ca.SX.sym("N", 3 * len(free)), ca.SX.sym("gamma", len(model.structure.strings))
    nodes = ca.reshape(N, 3, len(free))
    loads = []
    if model.has_external_force:
        loads.append(ca.DM((plant.external_force - model.constant_force)[:, free]))
    moved = model.acceleration(nodes, ca.DM.zeros(3, len(free)), gamma, *loads)
    to_coordinates = plant.coordinates.project(np.eye(plant.nodes.size))
    to_coordinates = to_coordinates[:, model.structure.free_rows]
    q = ca.mtimes(ca.DM(to_coordinates), ca.vec(moved))
    function = ca.Function(
        "held",
        [N],
        [
            ca.densify(ca.substitute(q, gamma, ca.SX.zeros(gamma.shape))),
            ca.vec(ca.densify(ca.jacobian(q, gamma))),
        ],
    )
    columns = shapes[:, :, free].transpose(0, 2, 1).reshape(len(shapes), -1).T
    offset, slope = evaluate_columns(function, np.asfortranarray(columns))
    r = plant.degrees_of_freedom
    return offset.T.copy(), slope.T.reshape(len(shapes), -1, r).swapaxes(1, 2).copy()
