"""Tables of a scene for the closed loop: controller, winches, sensors, estimator, faults."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import module_from_spec
from inspect import signature
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import Actuation, refuse_passive
from tenscontrol.actuation.motors import Motor
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray
from tenscontrol.control.controller import BaseController, Controller
from tenscontrol.control.function_controller import as_controller
from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.dynamics.model import Model
from tenscontrol.estimation.kalman_filter import KalmanFilter
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.files import read_file
from tenscontrol.plant.linearize import linearize
from tenscontrol.plant.reference import Reference
from tenscontrol.scene import schema
from tenscontrol.scene.document import Document, Table
from tenscontrol.scene.kinds import BY_STRING
from tenscontrol.scene.structure_tables import columns, per_string
from tenscontrol.shape.demands import Demand, Height, NodesAt, Twist
from tenscontrol.shape.shape_path import shape_path
from tenscontrol.shape.target import ShapeTarget, shape_target
from tenscontrol.simulation.faults import Fault
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.segments import whole_strings
from tenscontrol.structure.structure import Structure

# What is designed on: the model with its strings whole, about its equilibrium.
Design = tuple[Model, Prestress]

# Of a file of Python.
_MOST_BYTES = 10_000_000


def build_controller(
    document: Document,
    design: Callable[[], Design],
    structure: Structure,
    force_density: FloatArray,
    winches: Winches | None,
    held: str,
    allow_code: bool,
) -> BaseController:
    """Return the controller, designed on whole strings about an equilibrium.

    ``structure`` and its γ, shape (α,), are those with whole strings; ``held`` is what the
    actuators hold; ``allow_code`` whether the Python code that the scene names may run.
    """
    kind, table = document.table("controller").chosen("kind", schema.CONTROLLER_KEYS)
    if kind == "python":
        return _own_controller(table, design, structure, force_density, held, allow_code)
    model, rest = design()
    input = table.choice("input", ("force_density", "rest_length"), "force_density")
    if "sample_time" in table:
        with table.checked("sample_time"):
            validation.positive_number("sample_time", table.get("sample_time"), "s")
    table.need_required()
    arguments: dict[str, Any] = {
        key: per_string(table, key, structure) if isinstance(value, dict) else value
        for key, value in table.without("kind", "input", "actuated").items()
    }
    with table.checked():
        plant = linearize(model, rest, input=input, actuated=_actuated(table, structure))
    if "tracked" in table:
        rows = [_row(entry, structure) for entry in _entries(table, "tracked", schema.TRACKED)]
        arguments["tracked"] = np.vstack(rows)
    if "outputs" in table:
        arguments["outputs"] = [
            _limit(e, structure) for e in _entries(table, "outputs", schema.OUTPUT)
        ]
    if "reference" in table:
        bounds = {"min_force_density", "max_force_density"} & arguments.keys()
        limits = {key: arguments[key] for key in bounds} | {"winches": winches, "plant": plant}
        arguments["reference"] = _build_reference(table, model, rest, limits)
    # A law in continuous time knows neither speeds in a sample nor ramps through it.
    takes_winches = "winches" in signature(schema.CONTROLLERS[kind]).parameters
    if takes_winches and input == "rest_length" and "sample_time" in table:
        arguments["winches"] = winches
    with table.checked():
        controller: Controller = schema.CONTROLLERS[kind](plant, **arguments)
    return controller


def _actuated(table: Table, structure: Structure) -> Any:
    """Return the strings that are driven, with ratios by index where the file has their digits."""

    def winch(strings: Any) -> Any:
        if not isinstance(strings, dict):
            return strings
        groups = structure.string_groups
        return {
            int(key) if key.isdecimal() and key not in groups else key: ratio
            for key, ratio in strings.items()
        }

    given = table.get("actuated")
    return {k: winch(value) for k, value in given.items()} if isinstance(given, dict) else given


def _own_controller(
    table: Table,
    design: Callable[[], Design],
    structure: Structure,
    force_density: FloatArray,
    held: str,
    allow_code: bool,
) -> BaseController:
    """Return the controller that Python code gives: a function, or what a factory makes."""
    given = [key for key in ("function", "factory") if key in table]
    if len(given) != 1:
        count = "both" if given else "neither"
        raise table.error(None, f"{table.title} expects one of function and factory, found {count}")
    if given == ["function"] and "settings" in table:
        raise table.error("settings", f"in {table.title}, settings are arguments of a factory")
    input = table.choice("input", ("force_density", "rest_length"), held)
    imported = _imported(table, given[0], allow_code)
    actuated = _actuated(table, structure)
    if given == ["factory"]:
        with table.checked("factory"):
            plant = linearize(*design(), input=input, actuated=actuated)
            imported = imported(plant, **table.get("settings", {}))
    limits: dict[str, Any] = {
        key: per_string(table, key, structure)
        for key in ("low", "high", "max_change")
        if key in table
    }
    settings = limits | table.given("input", "sample_time")
    beside = sorted(settings.keys() - {"input"})
    if actuated is not None:
        settings["actuated"] = actuated
        beside += ["actuated"] if given == ["function"] else []
    if isinstance(imported, BaseController) and beside:
        reason = f"{given[0]} gives {imported!r}, which has limits and a sample time of its own"
        raise table.error(beside[0], f"in {table.title}, {reason}")
    with table.checked(given[0]):
        # In place of a decision γ is that of the prestress; rest lengths are those at the start.
        if settings.get("input", getattr(imported, "input", held)) == "force_density":
            settings["equilibrium_input"] = force_density
        return as_controller(imported, structure, held, **settings)


def _imported(table: Table, key: str, allow_code: bool) -> Any:
    """Return what ``"module:name"`` or ``"file.py:name"`` names; that runs the code there."""
    text = str(table.need(key))
    place, _, name = text.rpartition(":")
    is_file = place.endswith(".py")
    if not name.isidentifier() or not (is_file or all(map(str.isidentifier, place.split(".")))):
        raise table.error(
            key, f"in {table.title}, {key} is {text!r:.60}, expected 'file.py:name', relative "
            "to the scene file, or 'module:name'"
        )  # fmt: skip
    path = _within_folder(table, key, place) if is_file else None
    if not allow_code:
        where = f"the module {place}" if path is None else f"the file {path}"
        raise table.error(
            key,
            f"in {table.title}, {key} runs Python code, {name} of {where}, and no code was "
            "allowed: read it, and if you trust it, give load_scene(file, allow_code=True), or "
            "--allow-code on the command line",
        )
    try:
        module = import_module(place) if path is None else _run_file(path)
    except (ImportError, OSError, SyntaxError, ValueError) as error:  # ValueError: a NUL
        raise table.error(
            key, f"in {table.title}, {key}: {place} is not loaded: {error}"
        ) from error
    if not hasattr(module, name):
        raise table.error(key, f"in {table.title}, {key}: {place} has no {name}")
    return getattr(module, name)


def _within_folder(table: Table, key: str, place: str) -> Path:
    """Return a file in the folder of the scene, or below it, with links resolved."""
    folder = os.path.realpath(Path(table.document.file).parent)
    with table.checked(key):
        path = Path(os.path.realpath(os.path.join(folder, place)))
        if not path.is_relative_to(folder):
            raise ValueError(
                f"{key} is the file {path}, expected one in the folder of the scene, {folder}, or "
                "below it: copy it there"
            )
    return path


class _SourceLoader(SourceFileLoader):
    """Runs what a file says: a compiled copy beside it may say something else."""

    def get_data(self, path: str) -> bytes:
        return read_file(Path(path), _MOST_BYTES)

    def get_code(self, fullname: str) -> CodeType:
        code: CodeType = self.source_to_code(self.get_data(self.path), self.path)
        return code


def _run_file(path: Path) -> ModuleType:
    """Return a Python file as a module."""
    name = f"_scene_{path.stem}"
    loader = _SourceLoader(name, str(path))
    module = module_from_spec(ModuleSpec(name, loader, origin=str(path)))
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses and pickle look for it there
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]  # as import does: others read the files of modules that are there
        raise
    return module


def _build_reference(
    table: Table, model: Model, rest: Prestress, limits: dict[str, Any]
) -> Reference:
    """Return the path from ``rest`` by the shapes of ``[[controller.reference]]``."""
    sample_time = table.need("sample_time")
    groups = np.array(model.structure.string_groups)
    level = float(rest.force_density[groups == groups[0]].mean())
    here: Prestress | ShapeTarget = rest
    nodes, now = model.structure.nodes, 0.0
    times: list[FloatArray] = [np.zeros(1)]
    shapes, gammas = [nodes[:, :, None]], [rest.force_density[:, None]]
    for entry in _entries(table, "reference", schema.WAYPOINT):
        begin, end = _span(entry, now)
        demands = _demands(entry, table, model.structure)
        with entry.checked("time"):
            settings: dict[str, Any] = {"force_density": entry.get("force_density", level)}
            if "force_density" not in entry and not limits["plant"].actuation.is_whole:
                settings = {"prestress": "least"}  # passive strings say how taut it is
            goal = shape_target(model, demands, start=nodes, **settings, **limits)
            path = shape_path(model, here, goal, duration=end - begin, step=sample_time, **limits)
        # Before a later start the shape is held: it is there twice.
        first = 0 if begin > now else 1
        times.append(begin + path.time[first:])
        shapes.append(path.nodes[:, :, first:])
        gammas.append(path.force_density[:, first:])
        here, nodes, now = goal, goal.nodes, end
    return Reference(
        np.concatenate(times), np.concatenate(shapes, axis=2), np.concatenate(gammas, axis=1)
    )


def _entries(table: Table, key: str, known: schema.Keys) -> Iterator[Table]:
    given = table.need(key)
    if not given:
        raise table.error(key, f"in {table.title}, {key} is empty; leave it out, or give an entry")
    for i, values in enumerate(given):
        title = f"[[controller.{key}]] number {i + 1}"
        yield Table(table.document, (*table.path, key, i), title, values, known)


def _limit(entry: Table, structure: Structure) -> OutputLimit:
    if "low" not in entry and "high" not in entry:
        raise entry.error(None, f"{entry.title} has no limit: give low or high, m")
    row = _row(entry, structure)
    with entry.checked():
        return OutputLimit(row[None], **entry.given("low", "high", "penalty"))


def _row(entry: Table, structure: Structure) -> FloatArray:
    """Return a node coordinate, or its difference from that of another node, as a row of C."""
    count = structure.nodes.shape[1]
    axis = entry.choice("axis", tuple("xyz"[: structure.dimension]))
    row = np.zeros((count, structure.dimension))
    row[entry.index("node", count, "nodes"), "xyz".index(axis)] += 1.0
    if "relative_to" in entry:
        row[entry.index("relative_to", count, "nodes"), "xyz".index(axis)] -= 1.0
    if not row.any():
        raise entry.error(
            "relative_to", f"in {entry.title}, relative_to is node itself, expected another"
        )
    return row.ravel()


def _span(entry: Table, now: float) -> tuple[float, float]:
    """Return when a move begins and ends, s."""
    with entry.checked("time"):
        end = validation.positive_number("time", entry.need("time"), "s")
    begin = now
    if "start" in entry:
        with entry.checked("start"):
            begin = float(validation.non_negative("start", np.array([entry.get("start")]), "s")[0])
            if not begin >= now:
                raise ValueError(f"start is {begin:g} s, expected at least {now:g} s")
    if not end > begin:
        raise entry.error(
            "time", f"in {entry.title}, time is {end:g} s, expected more than {begin:g} s"
        )
    return begin, end


def _demands(entry: Table, controller: Table, structure: Structure) -> list[Demand]:
    demands: list[Demand] = []
    with entry.checked():
        for key, demand in (("height", Height), ("twist", Twist)):
            if key in entry:
                demands.append(demand(entry.get(key), *_ends(entry, controller, structure)))
        if "nodes" in entry or "positions" in entry:
            positions = columns(entry, "positions", structure.dimension)
            demands.append(NodesAt(entry.need("nodes"), positions))
    if not demands:
        raise entry.error(
            None, f"{entry.title} asks for no shape: give height, twist, or nodes and positions"
        )
    return demands


def _ends(entry: Table, controller: Table, structure: Structure) -> tuple[list[int], list[int]]:
    """Return the nodes at the top and at the bottom: as given, or those of a prism."""
    if "top" in entry or "bottom" in entry:
        return entry.need("top"), entry.need("bottom")
    if controller.document.table("structure").get("generator") != "prism":
        raise entry.error(
            None, f"{entry.title} lacks the keys top and bottom: lists of node numbers"
        )
    sides = len(structure.bars)
    return list(range(sides)), list(range(sides, 2 * sides))


def build_winches(document: Document, structure: Structure) -> Winches | None:
    """Return the limits of the winches, one for each whole string, or None."""
    if not document.has("winches"):
        return None
    table = document.table("winches")
    settings: dict[str, Any] = {}
    motor: dict[str, Any] = {}
    motor_keys = schema.keys_of(Motor)
    for key, value in table.values.items():
        by_string = table.keys[key].kind is BY_STRING
        arguments = motor if key in motor_keys else settings
        arguments[key] = per_string(table, key, whole_strings(structure)) if by_string else value
    if motor:
        table.need("drum_radius")
    with table.checked():
        return Winches(**settings, motor=Motor(**motor) if motor else None)


def build_estimator(
    document: Document,
    model: Model,
    rest: Prestress,
    input: str,
    sample_time: float,
    winches: Winches | None,
    controller: BaseController,
) -> KalmanFilter:
    """Return the Kalman filter on whole strings, for the input of the actuators."""
    sensors, estimator = document.table("sensors"), document.table("estimator")
    estimator.choice("kind", ("kalman",))
    with sensors.checked():
        validation.whole_number("seed", sensors.get("seed", 0), 0, validation.LARGEST_SEED)
        given = sensors.without("seed")
        if "anchors" in given:
            given["anchors"] = np.transpose(given["anchors"])
        if "encoder" in given and winches is not None:
            given["motor"] = winches.motor
        readings = Sensors(structure=model.structure, **given)
    actuated = controller.actuation if controller.input == input else None
    with estimator.checked():
        plant = linearize(model, rest, input=input, actuated=actuated)
        settings = estimator.without("kind")
        return KalmanFilter(plant, readings, sample_time=sample_time, winches=winches, **settings)


def build_faults(
    document: Document, strings: int, actuation: Actuation | None
) -> tuple[Fault, ...]:
    """Return the faults; ``strings`` can be cut; ``actuation`` is that of the controller."""
    faults: list[Fault] = []
    for table in document.entries("faults"):
        kind, entry = table.chosen("kind", schema.FAULT_KEYS)
        if kind != "cut_string" and actuation is None:
            raise entry.error("kind", f"{entry.title} goes with a table [controller]")
        entry.need_required()
        if kind == "cut_string":
            entry.index("string", strings, "strings")
        elif kind == "stuck_winch":
            assert actuation is not None  # refused above
            string = entry.index("string", len(actuation.input), "winches")
            with entry.checked("string"):
                refuse_passive(actuation, "string", np.array([string]))
        with entry.checked():
            faults.append(schema.FAULTS[kind](**entry.without("kind")))
    return tuple(faults)
