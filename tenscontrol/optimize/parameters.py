"""Parameters that a run can be differentiated by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import prod

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import BAR_INPUTS
from tenscontrol.actuation.motors import motor_numbers
from tenscontrol.arrays import FloatArray
from tenscontrol.control.lqr import LQR
from tenscontrol.dynamics.equation import gravity_forces
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import ground_numbers, law_parameters
from tenscontrol.dynamics.profile import Pieces, Profile, polynomial_at
from tenscontrol.simulation.scene import Scene

#: Kinds of parameters that the equation of motion does not have.
BESIDE = frozenset({"nodes", "velocities", "input", "supports", "bars", "motor", "gain"})


# Numbers of motors that rest lengths depend on.
_OF_MOTORS = tuple(
    f"motor.{name}"
    for name in ("drum_radius", "gear_ratio", "torque", "speed", "inertia", "lag", "backlash")
)


@dataclass(frozen=True, eq=False)
class Parameter:
    """Something that a run depends on.

    Attributes
    ----------
    name : str
    kind : {"nodes", "velocities", "input", "supports", "bars", "strings", "ground", "bar_mass", \
"point_mass", "gravity", "external_force", "motor", "gain"}
    shape : tuple of int
    pieces : Pieces, optional
        Of an input or a motion that is a profile: what the values at its K times count by, one row
        each.
    law : int
        Which contact law, of the ground.
    field : str
        Which parameter of a law.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    pieces: Pieces | None = None
    law: int = 0
    field: str = ""

    @property
    def size(self) -> int:
        """Number of entries."""
        return prod(self.shape)


def parameters_of(scene: Scene, to: object) -> tuple[Parameter, ...]:
    """Return what a run of a scene is to be differentiated by, after checking the names."""
    if not isinstance(to, (list, tuple)) and (isinstance(to, str) or not isinstance(to, Sequence)):
        raise validation.wrong_kind("to", to, "a list of names, as ['rest_length', 'stiffness']")
    known = known_parameters(scene)
    if not len(to):
        raise ValueError(f"to is empty, expected some of {sorted(known)}")
    names = [validation.choice(f"to[{i}]", name, known) for i, name in enumerate(to)]
    if len(set(names)) < len(names):
        twice = {name for name in names if names.count(name) > 1}
        raise ValueError(f"to names {sorted(twice)} twice, expected each once")
    return tuple([known[name] for name in names])


def known_parameters(scene: Scene) -> dict[str, Parameter]:
    """Return all that a run of a scene can be differentiated by."""
    model = scene.model
    known = model.prepared.get(("parameters", scene.input), partial(_of_model, model, scene.input))
    held = scene.input in known and scene.law is None
    if held and not isinstance(getattr(scene, scene.input), Profile):
        known = known.copy()
    else:
        known = known | ({scene.input: _input(scene)} if scene.input in known else {})
    parameters: list[Parameter] = []
    if scene.supports is not None and not callable(scene.support_motion):
        parameters.append(_of_supports(scene))
    if scene.bars is not None and not scene.bars.is_commanded and not callable(scene.bar_length):
        parameters.append(_of_bars(scene))
    if scene.law is not None:
        parameters += _of_motors(scene)
        if isinstance(scene.law, LQR):
            parameters.append(Parameter("gain", "gain", scene.law.gain.shape))
    return known | {parameter.name: parameter for parameter in parameters} if parameters else known


def _of_model(model: Model, input: str) -> dict[str, Parameter]:
    """Return what a motion of a model depends on under an input that is held."""
    d, n = shape = model.structure.nodes.shape
    parameters, count = list[Parameter](), len(model.structure.strings)
    parameters += [
        Parameter("nodes", "nodes", shape), Parameter("velocities", "velocities", shape)
    ]  # fmt: skip
    if count:
        parameters.append(Parameter(input, "input", (count,)))
    if input == "rest_length":
        parameters += [
            Parameter(name, "strings", (count,), field=name) for name in law_parameters(model)
        ]
    parameters += [
        Parameter("bar_mass", "bar_mass", (len(model.structure.bars),)),
        Parameter("point_mass", "point_mass", (n,)),
        Parameter("gravity", "gravity", (d,)),
        Parameter("external_force", "external_force", shape),
    ]
    parameters += [
        Parameter(name, "ground", (), law=law, field=number)
        for name, (law, number) in ground_numbers(model).items()
    ]
    return {parameter.name: parameter for parameter in parameters}


def sample_times(scene: Scene) -> FloatArray:
    """Return when a controller gives its commands, s."""
    assert scene.law is not None  # else there are none
    given = scene.law.sample_time, scene.sample_time, scene.integration.step
    sample = next(time for time in given if time is not None)
    return np.arange(scene.begin, scene.begin + scene.duration * (1 - 1e-9), sample)


def _input(scene: Scene) -> Parameter:
    """Return the input of the strings: constant, at the times of a profile, or a sample."""
    count, given = len(scene.structure.strings), getattr(scene, scene.input)
    if scene.law is None and isinstance(given, Profile) and given.values.ndim == 2:
        return Parameter(scene.input, "input", (count, len(given.time)), _unit_pieces(given))
    if scene.law is None:
        return Parameter(scene.input, "input", (count,))
    ticks = sample_times(scene)
    unit = Profile(ticks, np.eye(len(ticks)), "hold")
    return Parameter(scene.input, "input", (count, len(ticks)), unit.pieces)


def _of_motors(scene: Scene) -> list[Parameter]:
    """Return numbers by which winches follow commands: positive, of each string its own."""
    winches, law = scene.winches, scene.law
    if winches is None or law is None or scene.input != "rest_length":
        return []
    if law.input in BAR_INPUTS:
        return []
    motor, count = winches.motor, len(law.commanded.strings)
    numbers = {} if motor is None else motor_numbers(motor, count)
    names = [
        name
        for name in _OF_MOTORS
        if np.all((value := numbers.get(name, np.zeros(count))) > 0) and np.isfinite(value).all()
    ]
    if winches.rate is not None and law.actuation.is_whole and np.isfinite(winches.rate).all():
        names.append("winches.rate")
    return [Parameter(name, "motor", (count,), field=name.split(".")[1]) for name in names]


def _of_supports(scene: Scene) -> Parameter:
    """Return the motion of supports: a displacement, or displacements at the times of a profile."""
    shape, given = (scene.structure.dimension, len(scene.structure.fixed)), scene.support_motion
    if isinstance(given, Profile):
        pieces = _unit_pieces(given)
        return Parameter("support_motion", "supports", (*shape, len(given.time)), pieces)
    return Parameter("support_motion", "supports", shape)


def _of_bars(scene: Scene) -> Parameter:
    """Return the lengths of bars: constant, or at the times of a profile."""
    count, given = len(scene.structure.bars), scene.bar_length
    if isinstance(given, Profile):
        pieces = _unit_pieces(given)
        return Parameter("bar_length", "bars", (count, len(given.time)), pieces)
    return Parameter("bar_length", "bars", (count,))


def _unit_pieces(profile: Profile) -> Pieces:
    unit = np.eye(len(profile.time))
    rates = None if profile.rates is None else 0 * unit
    return Profile(profile.time, unit, profile.interpolation, rates).pieces


def shares(
    parameter: Parameter, time: FloatArray, within: FloatArray, order: int = 0
) -> FloatArray | None:
    """Return by what the values of a profile count at times, shape (K, T), or those of its rates.

    By the pieces of the times ``within``, of which they may be the ends. None for what is one
    number an entry.
    """
    pieces = parameter.pieces
    if pieces is None:
        return None
    i = pieces.index(within)
    coefficients = pieces.coefficients[i].transpose(1, 2, 0)
    return polynomial_at(coefficients, time - pieces.origin[i], order)


def spread(
    parameter: Parameter, matrix: FloatArray, time: FloatArray, within: FloatArray, order: int = 0
) -> FloatArray:
    """Return what values of a motion, or their rates, move by a matrix, shape (T, ·, P).

    The motion has an entry for each column; see :func:`shares` for the times.
    """
    share = shares(parameter, time, within, order)
    if share is None:  # a number that stays
        return np.repeat(matrix[None] * (order == 0), len(time), axis=0)
    products = np.einsum("ij,kt->tijk", matrix, share)
    return np.asarray(products).reshape(len(time), len(matrix), -1)


def unit_load(model: Model) -> FloatArray:
    """Return forces of one along each axis of each node, (d n, d n), columns as a load (d, n)."""
    d, n = model.structure.nodes.shape
    rows = np.arange(d * n).reshape(n, d).T.ravel()
    return np.eye(d * n)[:, rows]


def load_of_gravity(model: Model) -> FloatArray:
    """Return the weights by an acceleration of one along each axis, shape (d n, d), kg."""
    structure, d = model.structure, model.structure.dimension
    weights = gravity_forces(structure, np.eye(d), structure.bar_mass, structure.point_mass)
    return np.stack([weight.ravel(order="F") for weight in weights], axis=1)
