"""What the C code of a controller is called with, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from tenscontrol.actuation.driven_strings import Actuation
from tenscontrol.arrays import FloatArray
from tenscontrol.control.controller import Controller
from tenscontrol.control.measurement_check import MeasurementCheck
from tenscontrol.deploy.measurement_code import measurement
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.shape.rolling import RollingGait
from tenscontrol.structure.structure import Structure


@dataclass(frozen=True, eq=False)
class CodeInterface:
    """The measured motion and the commands of a controller in C."""

    kind: str
    structure: Structure  # whose nodes are measured
    nodes: FloatArray  # with what supports hold at its place, shape (d, n), m
    input: str
    sample_time: float  # s
    bounds: tuple[FloatArray, FloatArray]  # of the commands, shape (m,) each
    change: FloatArray | None  # largest, from sample to sample, shape (m,)
    equilibrium_input: FloatArray  # commanded where nothing is known, shape (m,)
    actuation: Actuation
    input_names: list[str]
    check: MeasurementCheck
    plant: LinearPlant | None  # None for a gait, which takes the nodes as they are

    @property
    def state_count(self) -> int:
        """Numbers of the state that a law sees."""
        return 2 * (self.nodes.size if self.plant is None else self.plant.degrees_of_freedom)

    @property
    def functions(self) -> dict[str, ca.Function]:
        """The reduced state of a motion; none where a law sees the nodes."""
        return {} if self.plant is None else {"measure": measurement(self.plant)}


def interface_of(controller: Controller) -> CodeInterface:
    """Return that of a controller with a plant, which has a sample time."""
    plant = controller.plant
    assert controller.sample_time is not None  # checked with the law
    return CodeInterface(
        type(controller).__name__, plant.model.structure, plant.nodes, controller.input,
        controller.sample_time, controller.bounds, controller.largest_change,
        plant.equilibrium_input, controller.actuation, plant.input_names,
        controller.measurement_check, plant,
    )  # fmt: skip


def interface_of_gait(gait: RollingGait) -> CodeInterface:
    """Return that of a rolling gait."""
    settings = gait.settings
    structure, actuation = settings.structure, settings.plans.actuation
    names = actuation.names or [str(string) for string in actuation.lead]
    check = MeasurementCheck(structure, structure.nodes, 1 / settings.sample_time)
    return CodeInterface(
        type(gait).__name__, structure, structure.nodes, gait.input, settings.sample_time,
        settings.plans.bounds, None, np.asarray(settings.home), actuation,
        [f"rest_length_{name}" for name in names], check, None,
    )  # fmt: skip
