"""Turn and place of a structure that rolls, beside the state of a filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.estimation.extra_states import ExtraStates
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.structure.bar_geometry import rigid_shape
from tenscontrol.structure.supports import rigid_motions, rotation_between

# Readings of a structure that has turned: vectors turn with it, numbers stay.
_VECTORS = ("bar_direction", "bar_rate")
_NUMBERS = ("string_length", "string_tension", "encoder")

# A turn is seen where the coordinates leave out less than this part of it.
_LEFT_OUT = 1e-6


@dataclass(frozen=True, eq=False)
class RollingFrame:
    """A frame that turns with a structure, so that the state of a filter is of a small turn only.

    In it the operating point is not turned. ``start`` is a shape of the structure outside of it.

    Attributes
    ----------
    vectors : ndarray of int, shape (count, d)
        Entries of the readings that are vectors.
    angles : ndarray, shape (1 or 3, r)
        Turn by the coordinates, rad per m √kg.
    up : ndarray, shape (d,)
        Unit vector.
    basis, projection : ndarray, shape (d n, r), (r, d n)
        Of the coordinates.
    nodes, start : ndarray, shape (d, n)
        Operating point, and shape at the start, m.
    turned : int
        Blocks of r states that turn: displacements, rates, load.
    """

    vectors: IntArray
    angles: FloatArray
    up: FloatArray
    basis: FloatArray
    projection: FloatArray
    nodes: FloatArray
    start: FloatArray
    turned: int

    def __post_init__(self) -> None:
        freeze_arrays(self)


class RollingPose:
    """How a structure is turned, and where its lowest node touches the ground.

    After each correction the estimated turn goes from the state of the filter to the pose, as in
    the multiplicative filter of Lefferts, Markley & Shuster (1982), doi:10.2514/3.56190. The lowest
    node neither slides nor leaves the ground.
    """

    def __init__(self, frame: RollingFrame) -> None:
        self._frame = frame
        self.turn = rotation_between(frame.nodes, frame.start)
        self.lowest = int(np.argmin(frame.up @ frame.start))
        self.touch = frame.start[:, self.lowest]
        self.ground = float(frame.up @ self.touch)

    def in_frame(self, y: FloatArray) -> FloatArray:
        """Return readings as they are in the frame."""
        y = y.copy()
        rows = self._frame.vectors[np.isfinite(y[self._frame.vectors]).all(axis=1)]
        with np.errstate(over="ignore", invalid="ignore"):  # a reading may be of any size
            y[rows] = y[rows] @ self.turn
        return y

    def settle(
        self, z: FloatArray, P: FloatArray, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Take the turn out of a state, whose nodes and velocities in the frame are given."""
        frame = self._frame
        r, blocks = frame.basis.shape[1], range(frame.turned)
        step = _rotation(frame.angles @ z[:r])
        turned = frame.projection @ _each_turned(step.T, frame.basis)
        z, G = z.copy(), np.eye(len(z))
        displaced = step.T @ nodes - frame.nodes
        z[:r] = frame.projection @ displaced.ravel(order="F")
        z[r : 2 * r] = frame.projection @ (step.T @ velocities).ravel(order="F")
        for rows in (slice(r * k, r * (k + 1)) for k in blocks):
            G[rows, rows] = turned
            if rows.start >= 2 * r:
                z[rows] = turned @ z[rows]
        P = G @ P @ G.T
        self.turn = self.turn @ step
        # A rotation again, as round-off adds up.
        self.turn = self.turn @ (1.5 * np.eye(len(step)) - 0.5 * (self.turn.T @ self.turn))
        return z, 0.5 * (P + P.T)

    def place(self, nodes: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities of the frame outside of it, m and m/s."""
        up = self._frame.up
        nodes, velocities = self.turn @ nodes, self.turn @ velocities
        nodes = nodes + (self.touch - nodes[:, self.lowest])[:, None]
        velocities = velocities - velocities[:, [self.lowest]]
        heights = up @ nodes
        self.lowest = int(np.argmin(heights))
        nodes = nodes + ((self.ground - heights[self.lowest]) * up)[:, None]
        self.touch = nodes[:, self.lowest]
        return nodes, velocities

    def turned(self, fields: FloatArray) -> FloatArray:
        """Return displacement fields of the frame, shape (d n, k), outside of it."""
        return _each_turned(self.turn, fields)


def rolling_frame(
    plant: LinearPlant, sensors: Sensors, extra: ExtraStates, start: object
) -> RollingFrame:
    """Return the frame of a filter, for a shape at the start; raise where it cannot roll."""
    _refuse_outer_forces(plant)
    _refuse_other_readings(sensors)
    d = len(plant.nodes)
    frame = plant.coordinates
    fields = rigid_motions(plant.nodes)[:, d:]
    by_angle = frame.project(fields)
    away = fields - plant.basis @ by_angle
    away = away - rigid_motions(plant.nodes)[:, :d] @ _mean_of(away, d)
    if np.linalg.norm(away) > _LEFT_OUT * np.linalg.norm(fields):
        raise ValueError(
            f"rolling is True, but {sensors!r} does not show how the structure is turned: read "
            "bar_direction of two bars at least"
        )
    sizes = np.bincount(sensors.reading_of)
    firsts = np.r_[0, np.cumsum(sizes)]
    vectors = [
        firsts[i] + np.arange(d)
        for i, name in enumerate(sensors.readings)
        if name.startswith(_VECTORS) and sizes[i] == d
    ]
    nodes, structure = plant.nodes, plant.model.structure
    if start is not None:
        nodes = rigid_shape("start", structure, structure.checked_nodes("start", start))
    return RollingFrame(
        vectors=np.array(vectors),
        angles=np.asarray(np.linalg.pinv(by_angle), dtype=float),
        up=sensors.up,
        basis=plant.basis,
        projection=frame.project(np.eye(plant.nodes.size)),
        nodes=plant.nodes,
        start=nodes,
        turned=3 if extra.load else 2,
    )


def _refuse_outer_forces(plant: LinearPlant) -> None:
    """Refuse forces that depend on how the structure is turned, or hold it."""
    model = plant.model
    outer = {
        "driven bars": plant.drives_bars,
        "supports": len(model.structure.fixed_rows) > 0,
        "ground": model.contacts is not None,
        "gravity or a load": bool(np.any(plant.external_force)) or bool(model.gravity.any()),
    }
    present = [name for name, is_there in outer.items() if is_there]
    if present:
        raise ValueError(
            f"rolling is True, but the model of plant has {present[0]}, which does not turn with "
            "the structure: make the plant from Model(structure, strings=...) alone. What the "
            "ground does is process_noise to the filter"
        )


def _refuse_other_readings(sensors: Sensors) -> None:
    """Refuse readings that depend on the turn in other ways than vectors do."""
    others = [kind.name for kind in sensors.kinds if kind.name not in (*_VECTORS, *_NUMBERS)]
    if others:
        raise ValueError(
            f"rolling is True, but sensors read {others[0]}, which is neither a vector nor a "
            f"number that stays as the structure turns: expected {', '.join(_VECTORS + _NUMBERS)}"
        )
    biased = [name for name, _ in sensors.bias or () if name in _VECTORS]
    if biased:
        raise ValueError(
            f"rolling is True, but {biased[0]} has a bias, which does not turn with the structure: "
            "leave it out"
        )
    if not sensors.free_fall.any():
        raise ValueError("rolling is True, but sensors have gravity 0: give it, it says what is up")


def _mean_of(fields: FloatArray, d: int) -> FloatArray:
    """Return the mean over the nodes of fields, shape (d n, k) to (d, k)."""
    return np.asarray(fields.reshape(-1, d, fields.shape[1]).mean(axis=0))


def _each_turned(rotation: FloatArray, fields: FloatArray) -> FloatArray:
    """Return displacement fields, shape (d n, k), turned at each node."""
    by_node = fields.reshape(-1, len(rotation), fields.shape[1])
    return np.asarray((rotation @ by_node).reshape(fields.shape))


def _rotation(angles: FloatArray) -> FloatArray:
    """Return the rotation by a vector of angles, rad (Rodrigues); in the plane by one angle."""
    size = float(np.sqrt(angles @ angles))
    first = np.sin(size) / size if size > 0 else 1.0
    second = 2 * (np.sin(size / 2) / size) ** 2 if size > 0 else 0.5
    if len(angles) == 1:
        K = angles[0] * np.array([[0.0, -1.0], [1.0, 0.0]])
    else:
        x, y, z = angles
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(len(K)) + first * K + second * (K @ K))
