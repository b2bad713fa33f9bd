"""Data of a Kalman filter for C code."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import moves_alike
from tenscontrol.deploy.code_interface import CodeInterface
from tenscontrol.deploy.controllers import LawCode
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.estimation.correction import MOST_REPEATS, SETTLED, Gate
from tenscontrol.estimation.filter_design import LEAST_NOISE, FilterDesign
from tenscontrol.estimation.kalman_filter import MOST_WIDER, NOTHING_KNOWN, WIDER, KalmanFilter
from tenscontrol.estimation.rolling_frame import RollingFrame, RollingPose
from tenscontrol.plant.driven_lengths import MOST_LENGTH, known_at_rest, known_size
from tenscontrol.plant.reduced_dynamics import near_symbol, reduced_motion, settled
from tenscontrol.structure.structure import different_members


def with_filter(law: LawCode, interface: CodeInterface, estimator: object) -> LawCode:
    """Return the code of a law with that of the filter that tells it where the structure is."""
    validation.instance(
        "estimator", estimator, KalmanFilter, "make one by KalmanFilter(plant, sensors, ...)"
    )
    assert isinstance(estimator, KalmanFilter)  # just checked
    design, plant = estimator.design, estimator.plant
    different = different_members(plant.model.structure, interface.structure, ())
    if different:
        raise ValueError(
            f"estimator is for {plant.model.structure!r}, but the controller for that with "
            f"{different}: design both on one structure"
        )
    if estimator.sample_time != interface.sample_time:
        raise ValueError(
            f"estimator has a sample time of {estimator.sample_time:g} s, but the controller one "
            f"of {interface.sample_time:g} s: give both the same"
        )
    both = plant.actuation, interface.actuation
    alike = np.array_equal(both[0].lead, both[1].lead)
    takes_commands = plant.input == interface.input
    if takes_commands:
        alike = moves_alike(*both)
    if not alike:
        raise ValueError(
            f"estimator has {both[0]!r}, but the controller {both[1]!r}, or other strings at other "
            "values: in C the filter takes the commands. Design both on plants of one operating "
            "point with the same actuated"
        )
    sensors, settings, s = estimator.sensors, design.settings, len(design.start)
    gate, sizes = Gate(sensors, settings.gate), np.bincount(sensors.reading_of)
    moved = design.sampled
    constants: dict[str, int | float] = {
        "FILTER_STATES": s,
        "FILTER_READINGS": len(sizes),
        "FILTER_LARGEST": int(sizes.max()),
        "FILTER_DELAY": sensors.delay,
        "FILTER_PATIENCE": settings.patience,
        "FILTER_SUBSTEPS": settings.substeps,
        "FILTER_NONLINEAR": int(design.motion is not None),
        "FILTER_REPEATS": MOST_REPEATS,
        "FILTER_SETTLED": SETTLED,
        "FILTER_WIDER": WIDER,
        "FILTER_MOST_WIDER": MOST_WIDER,
        "FILTER_LEAST_NOISE": LEAST_NOISE,
        "FILTER_NOTHING_KNOWN": NOTHING_KNOWN,
        "FILTER_TINY": float(np.finfo(float).tiny),
        "FILTER_KNOWN": known_size(plant),
        "FILTER_DRIVES_BARS": int(plant.drives_bars),
        "FILTER_MOST_LENGTH": MOST_LENGTH,
        "FILTER_ROLLS": int(design.frame is not None),
    }
    arrays = {
        "reading_noise": sensors.noise,
        "reading_of": sensors.reading_of,
        "reading_start": np.r_[0, np.cumsum(sizes)],
        "needs_input": sensors.needs_input.astype(np.int64),
        "gate_limit": gate.limit,
        "start_state": design.start,
        "start_covariance": design.start_covariance.ravel(),
        "process_covariance": design.process_covariance.ravel(),
        "filter_rest": known_at_rest(plant, plant.equilibrium_input),
    }
    if design.start_input is not None:
        arrays["start_input"] = design.start_input
    if design.frame is not None:
        more_constants, more_arrays = _frame(design.frame)
        constants |= more_constants
        arrays |= more_arrays
    matrices = {}
    functions = {"outputs": design.outputs, "shape": _shape(design)}
    if design.motion is None:
        arrays["filter_drift"] = moved.drift
        matrices = {
            "filter_transition": moved.transition,
            "filter_by_input": moved.by_input,
            "filter_by_previous": moved.by_previous * moved.ramp,
        }
    else:
        functions["motion"] = design.motion
    return replace(
        law,
        templates=(*law.templates, "filter.c", *(["sample.c"] if takes_commands else [])),
        constants=law.constants | constants,
        arrays=law.arrays | arrays,
        matrices=law.matrices | matrices,
        functions=law.functions | functions,
        numbers_read=len(sensors.noise),
    )


def _frame(frame: RollingFrame) -> tuple[dict[str, int | float], dict[str, np.ndarray]]:
    """Return constants and arrays of the frame of a structure that rolls."""
    pose = RollingPose(frame)
    constants: dict[str, int | float] = {
        "FRAME_SHAPES": frame.basis.shape[1],
        "FRAME_ANGLES": len(frame.angles),
        "FRAME_VECTORS": len(frame.vectors),
        "FRAME_TURNED": frame.turned,
        "FRAME_GROUND": pose.ground,
        "FRAME_LOWEST": pose.lowest,
    }
    arrays = {
        "frame_vector": frame.vectors[:, 0],
        "frame_angle": frame.angles.ravel(),
        "frame_up": frame.up,
        "frame_basis": frame.basis.ravel(),
        "frame_projection": frame.projection.ravel(),
        "frame_nodes": frame.nodes.ravel(order="F"),
        "frame_turn": pose.turn.ravel(),
        "frame_touch": pose.touch,
    }
    return constants, arrays


def _shape(design: FilterDesign) -> ca.Function:
    """Return ``(z, u) -> (vec N, vec V)`` of all states of a filter; not finite for no shape."""
    plant = design.plant
    z, u, near = (
        ca.SX.sym("z", len(design.start)),
        ca.SX.sym("u", known_size(plant)),
        near_symbol(plant),
    )
    N, V = reduced_motion(plant, z[: design.extra.states], near, u)
    outputs = [ca.densify(ca.vec(motion)) for motion in (N, V)]
    return Function("shape", [z, u], settled(plant, z, near, outputs, u))
