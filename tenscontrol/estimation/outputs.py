"""What sensors read, as a function of the reduced state and the input that is held."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.plant import LinearPlant, in_coordinates, model_input, reduced_motion
from tenscontrol.structure import left_by_supports, rigid_motions
from tenscontrol.validation import FloatArray, frozen

# A motion as one body that moves the readings less than this fraction of another is not seen.
_UNSEEN = 1e-9


def output_function(plant: LinearPlant, sensors: Sensors, more: int = 0) -> ca.Function:
    """Return ``(z, u) -> (y, ∂y/∂z)``, dense; exact, with bars of constant length.

    Parameters
    ----------
    plant : LinearPlant
        In internal or minimal coordinates, of the structure of the sensors.
    sensors : Sensors
    more : int
        Entries of z after the state of the plant, of which the readings do not tell.
    """
    structure = plant.model.structure
    z, u = ca.SX.sym("z", len(plant.A) + more), ca.SX.sym("u", plant.B.shape[1])
    N, V = reduced_motion(plant, z[: len(plant.A)])
    parts = []
    if sensors.nodes is not None:
        parts.append(ca.vec(N[:, sensors.nodes.tolist()]))
    S, Sd = (kernel.differences(part, structure.strings) for part in (N, V))
    length = ca.sqrt(kernel.dots(S, S)).T
    if sensors.strings is not None:
        parts.append(length[sensors.strings.tolist()])
    if sensors.bars is not None:
        bars = sensors.bars.tolist()
        scale = ca.DM(1 / structure.bar_length[bars]).T
        parts.append(
            ca.vec(kernel.scale_columns(kernel.differences(N, structure.bars[bars]), scale))
        )
    if sensors.tension_strings is not None:
        gamma = model_input(plant, u)
        if plant.input == "rest_length":
            law = plant.model.strings
            assert law is not None  # linearize needs one for this input
            gamma = law.symbolic_force_density(length, gamma, kernel.dots(S, Sd).T / length)
        parts.append((gamma * length)[sensors.tension_strings.tolist()])
    y = ca.vertcat(*parts)
    results = [ca.densify(y), ca.densify(ca.jacobian(y, z))]
    return ca.Function("readings", [z, u], ca.cse(results))


def output_matrix(plant: LinearPlant, sensors: Sensors) -> FloatArray:
    """Return C = ∂y/∂z at the operating point, shape (m, 2r)."""
    function = output_function(plant, sensors)
    return np.array(function(np.zeros(len(plant.A)), plant.equilibrium_input)[1].full())


def observed_plant(plant: LinearPlant, sensors: Sensors) -> LinearPlant:
    """Return the plant with those motions as one body that the sensors see.

    Internal coordinates know none. Node positions and bar directions see some: those are added,
    so that a structure that drifts or turns is not mistaken for one that changes its shape.
    A plant in minimal coordinates, which has them all, is returned as it is.
    """
    if plant.coordinates.kind != "internal":
        return plant
    if sensors.nodes is None and sensors.bars is None:
        return plant
    whole = in_coordinates(plant, "minimal")
    r = whole.degrees_of_freedom
    fields = left_by_supports(whole.model.structure, rigid_motions(whole.nodes))
    rigid = np.linalg.qr(whole.coordinates.project(fields))[0]
    moved = output_matrix(whole, sensors)[:, :r] @ rigid / sensors.noise[:, None]
    _, sizes, Vt = np.linalg.svd(moved)
    seen = Vt[: int(np.count_nonzero(sizes > _UNSEEN * sizes.max(initial=0.0)))]
    # Of the minimal coordinates, the internal ones and the motions that are seen.
    inside = whole.coordinates.project(plant.basis)
    keep = np.hstack([inside, rigid @ seen.T])
    return _restricted(whole, keep)


def _restricted(plant: LinearPlant, keep: FloatArray) -> LinearPlant:
    """Return the plant on the space of orthonormal columns of its coordinates, shape (r, k)."""
    frame = plant.coordinates
    twice = np.kron(np.eye(2), keep)
    projection = keep.T @ frame.project(np.eye(plant.nodes.size))
    return replace(
        plant,
        coordinates=replace(
            frame, basis=frozen(frame.basis @ keep), _projection=frozen(projection)
        ),
        A=frozen(twice.T @ plant.A @ twice),
        B=frozen(twice.T @ plant.B),
        drift=frozen(twice.T @ plant.drift),
    )
