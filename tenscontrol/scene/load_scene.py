"""From a scene file to a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.actuation import to_rest_length
from tenscontrol.dynamics import Model
from tenscontrol.integrate import METHODS
from tenscontrol.plant import equilibrium
from tenscontrol.scene.controller_tables import (
    build_controller,
    build_estimator,
    build_faults,
    build_winches,
)
from tenscontrol.scene.document import Document, Table, read_document
from tenscontrol.scene.scene import Scene
from tenscontrol.scene.structure_tables import (
    build_design,
    build_force_density,
    build_law,
    build_loads,
    build_start,
    build_structure,
)
from tenscontrol.validation import positive_number, wrong_kind

# With strings whose law is known, rest lengths are the input if nothing else is said.
_INPUTS = ("force_density", "rest_length")

# Keys of the motors of force-controlled cables.
_OF_CABLES = ("drum_radius", "gear_ratio", "torque", "zero")

_GO_WITH = (*((name, "controller") for name in ("winches", "sensors", "estimator")),
    ("sensors", "estimator"), ("estimator", "sensors"))  # fmt: skip


def load_scene(file: str | Path) -> Scene:
    """Return the scene that a TOML file describes.

    Parameters
    ----------
    file : str or Path

    Returns
    -------
    Scene

    Raises
    ------
    TypeError
        If ``file`` is no path.
    SceneError
        A ValueError: if the file cannot be read, is not TOML, lacks a table,
        has an unknown table or key or a value of another kind, or asks for
        something impossible; with file, line and key, and what is allowed.

    Notes
    -----
    Nodes and velocities are lists of ``[x, y, z]``, or of ``[x, y]`` in the plane, one for each
    node. All quantities are in SI units. A quantity of the strings is a number for all, a list, or
    a table by string group.

    ``[structure]``
        ``generator = "prism"``, or another function of :mod:`tenscontrol.library`, with its
        arguments, ``fixed`` and ``point_mass``; or the arguments of :class:`Structure`. ``fixed``
        has nodes and pairs of a node and an axis, ``[0, [4, "z"]]``; ``strings`` has pairs of nodes
        and paths of more.
    ``[skin]``, ``[subdivide]``
        The arguments of :func:`skin` and :func:`subdivide`. A skin comes first; its strings are
        cut too.
    ``[strings]``
        ``law = "linear"`` with ``stiffness`` or ``law = "elastic"`` with ``axial_rigidity``;
        ``damping``. ``per = "string"``: values of a whole string, which its segments in series
        keep. ``per = "segment"``: values of each segment.
    ``[loads]``
        ``gravity``; ``forces = [{node = 0, force = [0.0, 0.0, 1.0]}]``.
    ``[prestress]``
        ``force_density``: a number, for which :func:`prestress` finds a state of self-stress, with
        ``reference``; or the γ of all strings, in balance or not. ``min_force_density`` and
        ``max_force_density`` are bounds of the γ that it finds, with a number or alone. ``per`` as
        above: a segment under the tension of its string has s times its γ. ``shape_gives = true``:
        this is the γ before weights and loads act; the scene has the shape in balance with them,
        found by :func:`equilibrium`.
    ``[start]``
        ``velocities``; ``disturbance``, the distance by which the farthest node is moved at
        random, m, with ``seed``.
    ``[run]``
        ``duration``; ``step`` or ``tolerance``, ``method``, ``output_step``; ``input``,
        ``"rest_length"`` if there are ``[strings]``, else ``"force_density"``; ``sample_time`` of
        a controller in continuous time.
    ``[controller]``
        ``kind = "mpc"``, ``"nmpc"``, ``"feedback_linearization"`` or ``"lqr"`` with the arguments
        of :class:`MPC`, :class:`NMPC`, :class:`FeedbackLinearization` or :class:`LQR`. ``input`` as
        for :func:`linearize`; with ``"rest_length"``, MPC and NMPC know the winches of the scene.
        It is designed about the prestress, on the structure with its strings whole. With
        ``plants = 8``, MPCs are designed at eight shapes along the reference and take turns as a
        :class:`GainSchedule`.
    ``[[controller.reference]]``
        A shape to be reached at ``time``, s, through equilibria within the controller's bounds of γ
        and the limits of the winches: ``height``, m, and ``twist``, rad, between the nodes ``top``
        and ``bottom`` (those of a prism if not given); ``nodes`` with their ``positions``. The move
        begins at ``start``, s; at the end of the one before if not given. ``force_density``: mean γ
        of the group of the first string in that shape, N/m; that of the prestress if not given.
    ``[[controller.outputs]]``, ``[[controller.tracked]]``
        A node coordinate, ``node`` and ``axis = "x"``, ``"y"`` or ``"z"``, less that of the
        node ``relative_to``. As ``outputs`` with ``low`` and ``high``, m, and ``penalty``.
    ``[winches]``
        The arguments of :class:`Winches` and, for their motors, of :class:`Motor`.
    ``[sensors]``, ``[estimator]``
        The arguments of :class:`Sensors`, with ``seed`` of their noise;
        ``kind = "kalman"`` with the arguments of :class:`KalmanFilter`, which knows the winches
        of the scene. The controller then gets the estimate.
    ``[[faults]]``
        ``kind = "cut_string"``, ``"stuck_winch"`` or ``"lost_measurement"`` with the
        arguments of :class:`CutString`, :class:`StuckWinch` or :class:`LostMeasurement`.

    Examples
    --------
    >>> import tempfile, tenscontrol as tc
    >>> from pathlib import Path
    >>> text = '''
    ... [structure]
    ... generator = "prism"
    ... [prestress]
    ... force_density = {top = 17.3205, bottom = 17.3205, vertical = 9.0}
    ... [run]
    ... duration = 0.5
    ... step = 1e-3
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "prism.toml")
    ...     _ = file.write_text(text, encoding="utf-8")
    ...     scene = tc.load_scene(file)
    >>> scene.structure, scene.input, scene.simulate()
    (Structure(6 nodes, 3 bars, 9 strings), 'force_density', Trajectory(0.5 s, 501 states, rk4))
    """
    if not isinstance(file, str | Path):
        raise wrong_kind("file", file, "a path")
    document = read_document(file)
    structure = build_structure(document)
    laws = build_law(document, structure)
    gravity, forces = build_loads(document, structure)
    law, whole_law = laws or (None, None)
    load: Any = False if forces is None else forces
    with document.table("loads").checked():
        model = Model(structure, strings=law, external_force=load, gravity=gravity)
    shape_gives = bool(document.table("prestress").get("shape_gives"))
    acting = np.zeros_like(model.constant_force) if shape_gives else model.constant_force
    force_density = build_force_density(document, structure, acting)
    run = document.table("run")
    settings = _settings(run)
    input = run.choice("input", _INPUTS, _INPUTS[laws is not None])
    if input == "rest_length" and laws is None:
        raise run.error("input", "in [run], input is 'rest_length', which needs a table [strings]")
    rest_length = None
    if input == "rest_length":
        with document.table("prestress").checked("force_density"):
            found = to_rest_length(model, structure.nodes, force_density)
        rest_length = found.rest_length
    if shape_gives:
        given = force_density if rest_length is None else rest_length
        with document.table("prestress").checked("shape_gives"):
            rest = equilibrium(model, **{input: given})
        structure, force_density = rest.structure, rest.force_density
        model = Model(structure, strings=law, external_force=load, gravity=gravity)
    winches = build_winches(document, structure)
    _refuse_alone(document)
    controller = estimator = None
    if document.has("controller"):
        design, rest = build_design(document, structure, whole_law, gravity, forces, force_density)
        controller = build_controller(document, design, rest, winches)
        _refuse_contradictions(document, input)
        sample = controller.sample_time or settings["sample_time"] or settings["step"]
        estimator = build_estimator(document, design, rest, input, sample, winches)
    commanded = None if controller is None else len(controller.plant.commanded.strings)
    faults = build_faults(document, len(structure.strings), commanded)
    nodes, velocities = build_start(document, model)
    return Scene(
        file=document.file,
        model=model,
        nodes=nodes,
        velocities=velocities,
        force_density=force_density,
        rest_length=rest_length,
        controller=controller,
        winches=winches,
        estimator=estimator,
        seed=None if estimator is None else document.table("sensors").get("seed", 0),
        faults=faults,
        input=input,
        **settings,
    )


def _settings(run: Table) -> dict[str, Any]:
    """Return what [run] says of duration, steps and method, checked."""
    run.need("duration")
    settings: dict[str, Any] = {
        "method": run.choice("method", ("auto", *METHODS), "auto"),
        **{"step": None, "tolerance": 1e-6, "output_step": None, "sample_time": None},
        **run.without("method", "input"),
    }
    for key in run.without("method", "input"):
        with run.checked(key):
            positive_number(key, run.get(key), run.keys[key][1])
    name = settings["method"]
    if name != "auto":
        takes = METHODS[name].settings
        if "tolerance" not in takes and "step" not in run:
            raise run.error("method", f"in [run], method is {name!r}, which needs step, s")
        if "step" not in takes and "step" in run:
            raise run.error("step", f"in [run], {name!r} takes tolerance, not step")
    if "step" in run and "tolerance" in run:
        raise run.error("tolerance", "in [run], expected one of step and tolerance, found both")
    return settings


def _refuse_alone(document: Document) -> None:
    """Raise if the scene has a table, but not one that uses it."""
    for name, other in _GO_WITH:
        if document.has(name) and not document.has(other):
            raise document.error((name,), f"[{name}] goes with a table [{other}]")
    if "sample_time" in document.table("run") and not document.has("controller"):
        raise document.error(
            ("run", "sample_time"), "in [run], sample_time goes with a table [controller]"
        )


def _refuse_contradictions(document: Document, input: str) -> None:
    """Raise if the controller does not go with the other tables."""
    controller, run = document.table("controller"), document.table("run")
    if document.has("winches") and input == "force_density":
        given = document.table("winches")
        if "drum_radius" not in given or given.without(*_OF_CABLES):
            message = "[winches] limits rest lengths, but [run] holds force_density"
            raise document.error(("winches",), message)
    if controller.get("input") == "rest_length" and input == "force_density":
        raise controller.error(
            "input", "in [controller], input is 'rest_length', but [run] holds force_density"
        )
    sampled = "sample_time" in controller or "sample_time" in run or "step" in run
    if controller.get("kind") == "lqr" and not sampled:
        raise controller.error(
            None, "[controller] lacks the key sample_time, s, and [run] has no sample_time or step"
        )
    if "sample_time" in controller and "sample_time" in run:
        raise run.error(
            "sample_time",
            "in [run], sample_time is that of a law in continuous time, but [controller] has one; "
            "leave one of them out",
        )
