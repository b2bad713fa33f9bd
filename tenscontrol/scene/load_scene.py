"""Scene of a TOML file."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.rest_lengths import to_rest_length
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.methods import METHODS
from tenscontrol.plant.equilibrium import equilibrium
from tenscontrol.scene.controller_tables import (
    build_controller,
    build_estimator,
    build_faults,
    build_winches,
)
from tenscontrol.scene.document import Document, Table, read_document
from tenscontrol.scene.schema import FORCE_KEYS
from tenscontrol.scene.structure_tables import (
    build_design,
    build_force_density,
    build_ground,
    build_law,
    build_loads,
    build_start,
    build_structure,
    build_struts,
)
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene
from tenscontrol.structure.segments import to_strings, whole_strings
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import refuse_load_without_support

# With strings whose law is known, rest lengths are the input if nothing else is said.
_INPUTS = ("force_density", "rest_length")

# Keys of the motors of force-controlled cables.
_OF_CABLES = ("drum_radius", "gear_ratio", "torque", "zero")

_GO_WITH = (*((name, "controller") for name in ("winches", "sensors", "estimator")),
    ("sensors", "estimator"), ("estimator", "sensors"))  # fmt: skip


def load_scene(file: str | Path, allow_code: bool = False) -> Scene:
    """Return the scene that a TOML file describes.

    Parameters
    ----------
    file : str or Path
    allow_code : bool
        Whether a controller of ``kind = "python"`` may run the code that the scene names. A scene
        from elsewhere could do anything with it: read the code first.

    Returns
    -------
    Scene

    Raises
    ------
    TypeError
        If ``file`` is no path, or ``allow_code`` neither True nor False.
    SceneError
        A ValueError: if the file cannot be read, is not TOML, lacks a table,
        has an unknown table or key or a value of another kind, or asks for
        something impossible, or for code that is not allowed; with file, line
        and key, and what is allowed.

    Notes
    -----
    Nodes and velocities are lists of ``[x, y, z]``, or of ``[x, y]`` in the plane, one for each
    node. All quantities are in SI units. A quantity of the strings is a number for all, a list, or
    a table by string group.

    ``[structure]``
        ``generator = "prism"``, or another function of :mod:`tenscontrol.library`, with its
        arguments, ``fixed`` and ``point_mass``; or the arguments of :class:`Structure`, as
        :meth:`Structure.save` writes them. ``fixed`` has nodes and pairs of a node and an axis,
        ``[0, [4, "z"]]``; ``strings`` has pairs of nodes and paths of more.
    ``[skin]``, ``[subdivide]``
        The arguments of :func:`skin` and :func:`subdivide`. A skin comes first; its strings are
        cut too.
    ``[sections]``
        ``bars`` and ``strings``, names of :data:`tenscontrol.sizing.materials` or of tables
        ``[materials.name]`` with the arguments of :class:`Material`, and the radii or
        areas of :func:`sections`: bars, and strings if asked for, get the masses of these. They
        serve the whole strings; a skin comes before.
    ``[strings]``
        ``law = "linear"`` with ``stiffness`` or ``law = "elastic"`` with ``axial_rigidity``, that
        of the ``[sections]`` if not given; ``damping``. ``per = "string"``: values of a whole
        string, which its segments in series keep. ``per = "segment"``: values of each segment.
    ``[loads]``
        ``gravity``; ``forces = [{node = 0, force = [0.0, 0.0, 1.0]}]``.
    ``[ground]``, or ``[[ground]]`` for several
        ``kind = "linear"``, if not given, ``"hertz"`` or ``"smooth"`` with the arguments of
        :class:`Ground`, :class:`~tenscontrol.dynamics.HertzGround` or
        :class:`~tenscontrol.dynamics.SmoothGround`; ``height`` is a number.
    ``[prestress]``
        ``force_density``: a number, for which :func:`prestress` finds a state of self-stress, with
        ``reference``; or the γ of all strings, in balance or not. ``min_force_density`` and
        ``max_force_density`` are bounds of the γ that it finds, with a number or alone. ``per`` as
        above: a segment under the tension of its string has s times its γ. ``shape_gives = true``:
        this is the γ before weights and loads act; the scene has the shape in balance with them,
        found by :func:`equilibrium`. Where there is ground and nothing else to hold the weights,
        a number is the γ before they act too, and the structure starts in its shape, falling.
    ``[start]``
        ``velocities``; ``disturbance``, the distance by which the farthest node is moved at
        random, m, with ``seed``.
    ``[struts]``
        Bars that are driven: ``bars``, all if not given; ``time``, and for each time the
        ``length`` of each of them, ``[[1.0, 1.0], [1.2, 1.1]]``; ``interpolation = "cubic"``, if
        not given, or ``"linear"``, as of :class:`Profile`. Without a controller.
    ``[run]``
        ``duration``; ``step`` or ``tolerance``, ``method``, ``output_step``; ``input``,
        ``"rest_length"`` if there are ``[strings]``, else ``"force_density"``; ``sample_time`` of
        a controller in continuous time.
    ``[controller]``
        ``kind = "mpc"``, ``"nmpc"``, ``"feedback_linearization"`` or ``"lqr"`` with the arguments
        of :class:`MPC`, :class:`NMPC`, :class:`FeedbackLinearization` or :class:`LQR`. ``input`` as
        for :func:`linearize`; with ``"rest_length"``, MPC and NMPC know the winches of the scene.
        It is designed about the prestress, on the structure with its strings whole. ``actuated``
        are the driven strings, ``[0, "top"]``; strings that share a winch are a table by its name,
        ``{lid = ["top"], seesaw = {6 = 1.0, 7 = -1.0}}``. All others are passive.
        ``kind = "python"`` is a controller of your own, for which loading the scene runs code, if
        ``allow_code`` is true: ``function = "laws.py:damper"``, a file in the folder of the scene
        or below it, or ``"package.module:damper"``, a module that Python imports; or ``factory``,
        which is called as ``factory(plant, **settings)`` with the linear plant and the table
        ``[controller.settings]``, and returns a function or a controller; ``input``,
        ``sample_time``, ``low``, ``high`` and ``max_change`` as for :class:`FunctionController`,
        ``input`` that of the run if not given.
    ``[[controller.reference]]``
        A shape to be reached at ``time``, s, through equilibria within the controller's bounds of γ
        and the limits of the winches: ``height``, m, and ``twist``, rad, between the nodes ``top``
        and ``bottom`` (those of a prism if not given); ``nodes`` with their ``positions``. The move
        begins at ``start``, s; at the end of the one before if not given. ``force_density``: mean γ
        of the group of the first string in that shape, N/m; that of the prestress if not given,
        and where there are passive strings the least that holds the shape with them.
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
    ... duration = 0.15
    ... step = 1e-3
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "prism.toml")
    ...     _ = file.write_text(text, encoding="utf-8")
    ...     scene = tc.load_scene(file)
    >>> scene.structure, scene.input, scene.simulate()
    (Structure(6 nodes, 3 bars, 9 strings), 'force_density', Trajectory(0.15 s, 151 states, rk4))
    """
    if not isinstance(file, str | Path):
        raise validation.wrong_kind("file", file, "a path")
    validation.truth("allow_code", allow_code, "whether the scene may run code")
    return _Reading(read_document(file), allow_code).scene()


class _Reading:
    """A document that becomes a scene, part by part."""

    def __init__(self, document: Document, allow_code: bool) -> None:
        self._document, self._allow_code = document, allow_code
        self._structure = build_structure(document)
        self._laws = build_law(document, self._structure)
        self._gravity, self._forces = build_loads(document, self._structure)
        self._ground = build_ground(document, self._structure)
        loads = document.table("loads")
        with loads.checked():
            self._model = Model(
                self._structure,
                strings=None if self._laws is None else self._laws[0],
                external_force=False if self._forces is None else self._forces,
                gravity=self._gravity,
                ground=self._ground,
                **loads.given(*FORCE_KEYS),
            )
        self._settings = _settings(document.table("run"))
        self._find_shape()

    def _find_shape(self) -> None:
        """Find force densities, rest lengths, and the shape where these give it."""
        document, structure, model = self._document, self._structure, self._model
        shape_gives = bool(document.table("prestress").get("shape_gives"))
        acting = model.constant_force
        if shape_gives or (self._ground and not _is_held(structure, acting)):
            acting = np.zeros_like(acting)
        self._force_density = build_force_density(document, structure, acting)
        run = document.table("run")
        self._input = run.choice("input", _INPUTS, _INPUTS[self._laws is not None])
        if self._input == "rest_length" and self._laws is None:
            raise run.error(
                "input", "in [run], input is 'rest_length', which needs a table [strings]"
            )
        self._rest_length = None
        if self._input == "rest_length":
            with document.table("prestress").checked("force_density"):
                conversion = to_rest_length(model, structure.nodes, self._force_density)
            self._rest_length = conversion.rest_length
        if shape_gives:
            held = self._force_density if self._rest_length is None else self._rest_length
            with document.table("prestress").checked("shape_gives"):
                rest = equilibrium(model, **{self._input: held})
            self._structure, self._force_density = rest.structure, rest.force_density
            self._model = self._model.replace(structure=rest.structure)

    def _loop(self) -> dict[str, Any]:
        """Return controller, winches, estimator and seed, by name."""
        document, structure, input = self._document, self._structure, self._input
        winches = build_winches(document, structure)
        _refuse_alone(document)
        if not document.has("controller"):
            return {}
        whole_law = None if self._laws is None else self._laws[1]
        # Only designs need an equilibrium.
        design = cache(
            lambda: build_design(
                document, self._model, whole_law, self._forces, self._force_density
            )
        )
        together = to_strings(structure, "force_density", self._force_density)
        controller = build_controller(
            document, design, whole_strings(structure), together, winches, input, self._allow_code
        )
        _refuse_contradictions(document, input, controller.sample_time)
        parts: dict[str, Any] = {"controller": controller, "winches": winches}
        if document.has("estimator"):
            run = self._settings
            sample = controller.sample_time or run["sample_time"] or run["step"]
            parts["estimator"] = build_estimator(
                document, *design(), input, sample, winches, controller
            )
            parts["seed"] = document.table("sensors").get("seed", 0)
        return parts

    def scene(self) -> Scene:
        """Return the scene."""
        document, structure, loop = self._document, self._structure, self._loop()
        controller = loop.get("controller")
        actuation = None if controller is None else controller.actuation
        faults = build_faults(document, len(structure.strings), actuation)
        nodes, velocities = build_start(document, self._model)
        struts = build_struts(document, structure)
        held: dict[str, Any] = {}
        if self._rest_length is not None:
            lengths = self._rest_length
            if controller is not None and len(controller.structure.strings) != len(lengths):
                lengths = to_strings(structure, "rest_length", lengths)
            held = {"rest_length": lengths}
        elif controller is None:
            held = {"force_density": self._force_density}
        names = "method", "tolerance", "step", "output_step"
        with document.table("run").checked():
            return Scene(
                self._model, self._settings["duration"], nodes, velocities, **held, **loop,
                input=self._input, sample_time=self._settings["sample_time"], faults=faults,
                bar_length=struts, prestress=self._force_density, name=Path(document.file).stem,
                integration=Integration(**{name: self._settings[name] for name in names}),
            )  # fmt: skip


def _is_held(structure: Structure, load: FloatArray) -> bool:
    """Whether supports can balance the resultant of a load; else only the ground does."""
    try:
        refuse_load_without_support(structure, load)
    except ValueError:
        return False
    return True


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
            validation.positive_number(key, run.get(key), run.keys[key].unit or "no unit")
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


def _refuse_contradictions(document: Document, input: str, sample_time: float | None) -> None:
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
    if sample_time is None and "sample_time" not in run and "step" not in run:
        raise controller.error(
            None, "[controller] lacks the key sample_time, s, and [run] has no sample_time or step"
        )
    if "sample_time" in controller and "sample_time" in run:
        raise run.error(
            "sample_time",
            "in [run], sample_time is that of a law in continuous time, but [controller] has one; "
            "leave one of them out",
        )
