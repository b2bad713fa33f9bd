"""From what a user asks of MPC to the data of its program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control.input_bounds import input_bounds, largest_change
from tenscontrol.control.mpc.constraints import (
    Constraints,
    OutputLimit,
    RowBlock,
    output_block,
    string_block,
)
from tenscontrol.control.mpc.problem import Horizon
from tenscontrol.control.weights import energy_weights, weight_matrix
from tenscontrol.plant import (
    LinearPlant,
    Sampled,
    refuse_empty,
    refuse_unreachable,
    regulator_riccati,
    sampled,
    state_units,
    string_map,
    to_commanded_strings,
    to_model_strings,
)
from tenscontrol.validation import (
    FloatArray,
    frozen,
    instance,
    non_negative,
    per_member,
    positive,
    positive_number,
    whole_number,
)

# Input weight, in units of energy_weights, when the user gives none.
_INPUT_WEIGHT = {"force_density": 0.1, "rest_length": 1.0}

# Price of a violation by one level, against the cost of an input one level off.
_PENALTY = 1e2

# Longer horizons only fill memory: the terminal cost stands for what comes after.
_LONGEST = 10_000


@dataclass(frozen=True, eq=False)
class Wishes:
    """Limits that a user gave, unchecked; see :class:`MPC`."""

    max_force_density: object
    min_force_density: object
    max_tension: object
    max_change: object
    winches: Winches | None
    outputs: Sequence[OutputLimit]
    string_penalty: float


@dataclass(frozen=True, eq=False)
class Design:
    """Data of a program.

    Attributes
    ----------
    problem : Horizon
    constraints : Constraints
    sampled : Sampled
        What a sample does.
    low, high : ndarray, shape (α,)
        Least and largest command.
    """

    problem: Horizon
    constraints: Constraints
    sampled: Sampled
    low: FloatArray
    high: FloatArray

    @property
    def unwound(self) -> Horizon:
        """The problem with the state of the plant alone, as the nonlinear program has it.

        Where winches wind, the input before is no part of the state then, but what weighs or
        feeds back ``[z; v_before]`` stays.
        """
        s, problem = len(self.sampled.transition), self.problem
        return replace(
            problem,
            transition=self.sampled.transition,
            input_matrix=self.sampled.by_input,
            drift=self.sampled.drift,
            state_weight=problem.state_weight[:s, :s],
        )


def design(
    plant: LinearPlant, horizon: object, sample_time: float, Q: object, R: object, wishes: Wishes
) -> Design:
    """Return the data of a program, or raise naming the argument that does not fit."""
    states, count = plant.B.shape
    length = whole_number("horizon", horizon, 1, _LONGEST)
    refuse_empty(plant)
    low, high = _command_range(plant, wishes)
    natural_Q, natural_R = energy_weights(plant, by_mode=plant.input == "rest_length")
    state_weight = natural_Q if Q is None else weight_matrix("Q", Q, states, definite=False)
    input_weight = (
        _INPUT_WEIGHT[plant.input] * natural_R
        if R is None
        else weight_matrix("R", R, count, definite=True)
    )
    refuse_unreachable(plant)
    level = float(plant.force_density.max()) or float(high.max())
    if plant.input == "rest_length":
        lengths = plant.model.structure.string_length(plant.nodes)
        level = float(
            (to_commanded_strings(plant, "length", lengths) - plant.equilibrium_input).max()
        )
    substeps = 1 if wishes.winches is None else wishes.winches.substeps
    wound = sampled(plant, sample_time, substeps)
    transition, input_matrix = wound.augmented
    added = len(transition) - states
    weight = np.zeros_like(transition)
    weight[:states, :states] = state_weight
    unit, size = state_units(plant)
    units = np.r_[unit, np.full(added, size)]
    gain, _, cost, _ = regulator_riccati(
        transition, input_matrix, weight, input_weight, units, size, discrete=True
    )
    # The price is relative to the cost of an input one level off.
    penalty = wishes.string_penalty * level**2 * float(np.linalg.eigvalsh(input_weight).min())
    blocks = _row_blocks(plant, wishes, penalty)
    if wound.ramp:
        blocks = [block.wound(added) for block in blocks]
    constraints = Constraints(blocks, states)
    problem = Horizon(
        transition=transition,
        input_matrix=input_matrix,
        drift=np.r_[wound.drift, np.zeros(added)],
        state_weight=weight,
        input_weight=input_weight,
        terminal_weight=cost,
        low=low - plant.equilibrium_input,
        high=high - plant.equilibrium_input,
        change=largest_change(plant, wishes.max_change, wishes.winches, sample_time),
        length=length,
        level=level,
        feedback=gain,
        rows=constraints.rows(),
    )
    return Design(problem, constraints, wound, frozen(low), frozen(high))


def default_penalty(value: object) -> float:
    """Return the price of a violated string limit: the default for None, inf for a hard limit."""
    if value is None:
        return _PENALTY
    if not isinstance(value, int | float) or isinstance(value, bool) or not value > 0:
        raise ValueError(
            f"string_penalty is {value!r}, expected a positive number; inf for hard limits"
        )
    return float(value)


def checked_time_limit(value: object) -> float:
    """Return the time for a command, s; inf where none is given."""
    return np.inf if value is None else positive_number("time_limit", value, "s")


def _command_range(plant: LinearPlant, wishes: Wishes) -> tuple[FloatArray, FloatArray]:
    if plant.input == "rest_length":
        return input_bounds(plant, None, wishes.winches)
    if wishes.max_force_density is None:
        raise TypeError("max_force_density is None, expected a positive number in N/m")
    high = input_bounds(plant, wishes.max_force_density, wishes.winches)[1]
    least = _least_force_density(plant, wishes)
    over = np.flatnonzero(least > plant.force_density)
    if len(over):
        i = over[0]
        raise ValueError(
            f"min_force_density[{i}] is {least[i]:g} N/m, but string {i} has "
            f"{plant.force_density[i]:g} N/m at the operating point; expected at most that"
        )
    return least, high


def _least_force_density(plant: LinearPlant, wishes: Wishes) -> FloatArray:
    least = per_member("min_force_density", wishes.min_force_density, plant.B.shape[1], "string")
    return non_negative("min_force_density", least, "a string can only pull")


def _row_blocks(plant: LinearPlant, wishes: Wishes, penalty: float) -> list[RowBlock]:
    blocks = []
    strings = string_map(plant, plant.input)
    count = plant.B.shape[1]
    if plant.input == "rest_length":
        high = np.full(len(strings.force_density), np.inf)
        if wishes.max_force_density is not None:
            largest = per_member("max_force_density", wishes.max_force_density, count, "string")
            positive("max_force_density", largest, "force density in N/m")
            high = to_model_strings(plant, "force_density", largest)
        low = to_model_strings(plant, "force_density", _least_force_density(plant, wishes))
        level = float(strings.force_density.max())
        blocks.append(string_block("force_density", strings, low, high, level, penalty))
    if wishes.max_tension is not None:
        structure = plant.model.structure
        most = per_member("max_tension", wishes.max_tension, count, "string")
        positive("max_tension", most, "tension in N")
        if plant.commanded is not structure:
            most = most[structure.string_parent]
        over = np.flatnonzero(strings.tension > most)
        if len(over):
            i = over[0]
            raise ValueError(
                f"max_tension is {most[i]:g} N for string {i}, which has {strings.tension[i]:g} N "
                "at the operating point; expected at least that"
            )
        level = float(strings.tension.max()) or float(most.max())
        low = np.full(len(most), -np.inf)
        blocks.append(string_block("tension", strings, low, most, level, penalty))
    for i, limit in enumerate(wishes.outputs):
        instance(f"outputs[{i}]", limit, OutputLimit, "make one by OutputLimit(matrix, low, high)")
        blocks.append(output_block(plant, limit))
    return blocks
