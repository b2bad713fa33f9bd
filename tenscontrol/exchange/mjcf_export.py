"""MJCF, the model format of MuJoCo, written: bars as bodies, strings as spatial tendons."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import Actuation, actuation_of
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.contact_laws import Contacts, Ground
from tenscontrol.dynamics.held_inputs import held_value
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings
from tenscontrol.exchange.kinematic_tree import WORLD, KinematicTree, in_space
from tenscontrol.simulation.inputs import checked_load
from tenscontrol.simulation.start import initial_state
from tenscontrol.structure.structure import Structure

# MuJoCo's contacts are springs and dashpots where their impedance is its least: its default takes
# most of what other forces do from the bodies in contact, too.
_IMPEDANCE = 1e-4

# The speed of an impact, m/s, in which its linear damping takes what that of our law takes.
_IMPACT = 1.0

# Radii as parts of the size: of balls at nodes that touch, of bars and strings as they are drawn.
_BALL, _BAR, _STRING = 1e-4, 1e-2, 3e-3

# Bits by which MuJoCo tells which balls touch which plane.
_MOST_PLANES = 31

# A string pulls by any force, and never pushes.
_PULLING = (-1e30, 0.0)

# Joints that close a loop, as stiff as MuJoCo makes them: impedance, and time constant in steps.
_LOOP_IMPEDANCE, _LOOP_STEPS = 0.9999, 2.0

_INTEGRATORS = {
    "euler": "Euler", "rk4": "RK4", "implicit": "implicit", "implicitfast": "implicitfast",
}  # fmt: skip
_ACTUATORS = ("none", "rest_length", "force_density", "tension")


def to_mujoco(
    model: Model,
    *,
    rest_length: object = None,
    force_density: object = None,
    nodes: object = None,
    velocities: object = None,
    external_force: object = None,
    actuators: str = "none",
    step: float = 1e-3,
    integrator: str = "rk4",
    actuated: object = None,
) -> str:
    """Return a model as MJCF, the text that MuJoCo reads.

    Bars are bodies with the mass and inertia of thin bars, strings are spatial tendons without
    mass. Node ``i`` is the site ``ni``, string ``k`` the tendon ``sk``, bar ``j`` the geom
    ``barj``. A bar hangs on the support or the bar from which it is reached, by a ball joint (a
    hinge in the plane); joints that close a loop are ``connect`` constraints, which MuJoCo holds by
    stiff springs. A roller is a slide. The motion at the start is the keyframe ``start``. A planar
    structure is put into the plane of x and z. MuJoCo is not needed to write.

    Parameters
    ----------
    model : Model
        Strings with ``LinearStrings`` or ``ElasticStrings``, and ``Ground`` of flat planes.
    rest_length : float or array_like, shape (α,), optional
        Rest length of each string, m.
    force_density : float or array_like, shape (α,), optional
        Or the force density γ of each string, N/m, which stays as it is.
    nodes, velocities : array_like, shape (d, n), optional
        Motion at the start, m and m/s; the reference shape at rest if not given.
    external_force : array_like, shape (d, n), optional
        Constant load, N, for a model built with ``external_force=True``.
    actuators : {"none", "rest_length", "force_density", "tension"}
        What ``data.ctrl`` sets, a number a string. ``"none"``: strings are springs between 0 and
        the rest length, ``springlength="0 l0"``. ``"rest_length"``: l0, m, or with
        ``ElasticStrings`` its inverse 1/l0, 1/m, in which their law is linear. ``"force_density"``:
        γ, N/m. ``"tension"``: T, N. The keyframe ``start`` has the values of the start.
    step : float
        Step of MuJoCo, s.
    integrator : {"rk4", "euler", "implicit", "implicitfast"}
    actuated : sequence of int or str, array_like or Actuation, optional
        The strings that have an actuator, as for :func:`linearize`, and the order of their numbers
        in ``data.ctrl``; all if not given. The others are springs as with ``"none"``. An actuator
        of MuJoCo pulls at one tendon. Strings that share a winch have an actuator each, and the
        model has the coefficients of the winches: see Notes.

    Returns
    -------
    str

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or MuJoCo has no such string law, ground or support. The
        message says which.

    Notes
    -----
    MuJoCo's tendons go on damping when slack, where ours do not. Actuators never push, but a damped
    one pulls on a slack string that lengthens fast enough. MuJoCo's contacts have linear damping,
    as much as takes what ours takes in an impact at 1 m/s, and friction that is viscous below that
    of Coulomb. Constant loads are actuators without control, ``loadi``, after those of strings.

    Of strings that share a winch, or have a ratio, the model has three custom arrays, a number an
    actuator: with inputs u, one a winch, the values of the strings are ``winch_offset +
    winch_ratio * u[winch_input]``. ``data.ctrl`` takes these values, or their inverses as above.
    ``model.numeric("winch_ratio").data`` reads an array.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0), gravity=9.81)
    >>> text = tc.exchange.to_mujoco(model, rest_length=0.8, actuators="rest_length")
    >>> text.count("<spatial"), text.count("<general")
    (9, 9)
    >>> text = tc.exchange.to_mujoco(
    ...     model, rest_length=0.8, actuators="rest_length", actuated=["vertical"])
    >>> text.count("<spatial"), text.count("<general"), text.count("stiffness")
    (9, 3, 6)
    """
    validation.instance("model", model, Model, "make one by Model(structure, strings=...)")
    validation.choice("actuators", actuators, _ACTUATORS)
    validation.choice("integrator", integrator, _INTEGRATORS)
    timestep = validation.positive_number("step", step, "s")
    for term in model.forces("force_density").terms:
        if not isinstance(term, Contacts):
            raise ValueError(
                f"the model has {term.argument}, which is not exported to MuJoCo; leave it out by "
                f"model.replace({term.argument}=None)"
            )
    structure = model.structure
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    V = np.zeros_like(N)
    if velocities is not None:
        V = structure.checked_nodes("velocities", velocities)
    held = _held(model, rest_length, force_density, actuators)
    kind = "force_density" if rest_length is None else "rest_length"
    initial_state(model, N, V, kind, lambda: held, measured=False)
    load = checked_load(model, external_force)
    actuation = _actuation(structure, actuated, actuators, held)
    driven: list[int] = []
    if actuation is not None:
        driven = (actuation.driven if actuation.is_ganged else actuation.lead).tolist()
    document = _Document(
        model, N, V, held, kind, actuators, driven, load, timestep, integrator
    )  # fmt: skip
    if actuation is not None and actuation.is_ganged:
        document.add_winches(actuation)
    return document.text()


def _actuation(
    structure: Structure, actuated: object, actuators: str, held: FloatArray
) -> Actuation | None:
    """Return which strings have an actuator; None if none has."""
    if actuators == "none":
        if actuated is not None:
            raise ValueError(
                "actuated is given, but actuators is 'none': say what data.ctrl sets, for example "
                "actuators='rest_length'"
            )
        return None
    return actuation_of(structure, actuated, held)


def _held(model: Model, rest_length: object, force_density: object, actuators: str) -> FloatArray:
    """Return the rest lengths or force densities, shape (α,), if the string law allows them."""
    if rest_length is not None and force_density is not None:
        raise ValueError("both rest_length and force_density are given, expected one of them")
    if rest_length is None and force_density is None:
        if len(model.structure.strings):
            raise ValueError(
                "neither rest_length nor force_density is given, expected one of them: "
                "what the strings have at the start"
            )
        return np.zeros(0)
    law = model.strings
    if rest_length is not None and law is None:
        raise ValueError(
            "rest_length is given, but the model has no string law; build it as "
            "Model(structure, strings=LinearStrings(stiffness=...)), or give force_density"
        )
    if rest_length is not None and not isinstance(law, LinearStrings | ElasticStrings):
        raise ValueError(
            f"MuJoCo's tendons are springs of constant stiffness, not {type(law).__name__}; "
            "give force_density in place of rest_length"
        )
    if actuators == "rest_length" and rest_length is None:
        raise ValueError("actuators is 'rest_length', but force_density is given: give rest_length")
    return held_value(model.structure, rest_length, force_density)


class _Document:
    """The elements of a model, and their text."""

    def __init__(
        self, model: Model, nodes: FloatArray, velocities: FloatArray, held: FloatArray,
        kind: str, actuators: str, driven: list[int], load: FloatArray, step: float,
        integrator: str,
    ) -> None:  # fmt: skip
        self.model, self.structure, self.held = model, model.structure, held
        self.kind, self.actuators, self.driven = kind, actuators, driven
        self.tree = KinematicTree.of(self.structure, nodes)
        self.length = self.structure.string_length(nodes)
        self.force_density = held
        if kind == "rest_length":
            assert model.strings is not None  # rest lengths without a law were refused
            self.force_density = model.strings.force_density(self.length, held)
        self.size = float(np.ptp(nodes, axis=1).max())
        self.load, self.own_load = load, load - (model.constant_force - model.built_in_load)
        self.grounds = [(_flat(law), set(of.tolist())) for law, of, _ in (model.contacts or ())]
        if len(self.grounds) > _MOST_PLANES:
            raise ValueError(f"MuJoCo tells at most {_MOST_PLANES} planes with own nodes apart")
        self.root = Element("mujoco", model="tenscontrol")
        self.controls: list[float] = []
        self._head(step, integrator)
        self._world()
        self._loops(step)
        self._strings()
        self._loads()
        self._keyframe(velocities)

    def text(self) -> str:
        """Return the whole document."""
        ElementTree.indent(self.root)
        return ElementTree.tostring(self.root, encoding="unicode") + "\n"

    def add_winches(self, actuation: Actuation) -> None:
        """Add by which coefficients strings share winches, in the order of their actuators."""
        custom = SubElement(self.root, "custom")
        for name in ("input", "ratio", "offset"):
            values = getattr(actuation, name)[self.driven]
            SubElement(custom, "numeric", name=f"winch_{name}", data=_numbers(values))

    def _head(self, step: float, integrator: str) -> None:
        SubElement(self.root, "compiler", angle="radian", autolimits="true")
        gravity = in_space(self.model.gravity[:, None])[:, 0]
        option = SubElement(
            self.root, "option", timestep=_number(step), integrator=_INTEGRATORS[integrator],
            gravity=_numbers(gravity), cone="elliptic", tolerance="1e-14",
        )  # fmt: skip
        SubElement(option, "flag", autoreset="disable")
        self.option = option
        default = SubElement(self.root, "default")
        SubElement(default, "site", size=_number(_BALL * self.size))
        SubElement(default, "tendon", width=_number(_STRING * self.size), rgba="0.2 0.4 0.8 1")
        for group in dict.fromkeys(self.structure.string_groups):
            SubElement(default, "default", {"class": f"string-{group}"})
        bar = SubElement(default, "default", {"class": "bar"})
        SubElement(
            bar, "geom", type="capsule", size=_number(_BAR * self.size), contype="0",
            conaffinity="0", mass="0", rgba="0.3 0.3 0.3 1",
        )  # fmt: skip

    # ---- bodies ----

    def _world(self) -> None:
        structure, start = self.structure, self.tree.start
        world = SubElement(self.root, "worldbody")
        SubElement(world, "light", directional="true", dir="0.3 0.5 -1")
        SubElement(world, "site", name="space")
        self._planes(world)
        for node in structure.fixed.tolist():
            self._site(world, node, start[:, node])
        for bar in np.flatnonzero(np.isin(structure.bars, structure.fixed).all(axis=1)).tolist():
            geom = self._bar(world, bar, np.zeros(3))
            geom.set("mass", _number(structure.bar_mass[bar]))
        elements = {WORLD: world}
        weights = self.tree.inverse_weights() if self.grounds else np.zeros(len(self.tree.bodies))
        for i, body in enumerate(self.tree.bodies):
            parent = np.zeros(3) if body.parent == WORLD else self.tree.bodies[body.parent].origin
            element = elements[i] = SubElement(
                elements[body.parent], "body", name=body.name, pos=_numbers(body.origin - parent)
            )
            for joint in body.joints:
                axis = {"axis": _numbers(joint.axis)} if joint.axis.any() else {}
                SubElement(element, "joint", {"type": joint.kind} | axis)
            # MuJoCo wants an inertia of what slides, too: that of a point does nothing.
            inertia = body.mass if body.bar is None else body.inertia
            _inertial(element, body.centre, body.mass, inertia)
            if body.bar is not None:
                self._bar(element, body.bar, body.origin)
            for node in body.nodes:
                position = start[:, node] - body.origin
                self._site(element, node, position)
                self._balls(element, node, position, weights[i])
                if body.bar is not None and structure.point_mass[node]:
                    payload = SubElement(
                        element, "body", name=f"mass{node}", pos=_numbers(position)
                    )
                    _inertial(payload, np.zeros(3), structure.point_mass[node], 0.0)

    def _bar(self, element: Element, bar: int, origin: FloatArray) -> Element:
        ends = self.tree.start[:, self.structure.bars[bar]].T - origin
        ends_text = _numbers(ends.ravel())
        return SubElement(element, "geom", {"class": "bar"}, name=f"bar{bar}", fromto=ends_text)

    def _site(self, element: Element, node: int, position: FloatArray) -> None:
        SubElement(element, "site", name=f"n{node}", pos=_numbers(position))

    def _loops(self, step: float) -> None:
        """Join the bodies that close loops, at a node that is part of the second."""
        if not self.tree.loops:
            return
        equality = SubElement(self.root, "equality")
        for node, body, home in self.tree.loops:
            first = self.tree.bodies[body]
            other = {} if home == WORLD else {"body2": self.tree.bodies[home].name}
            SubElement(
                equality, "connect", {"body1": first.name} | other,
                anchor=_numbers(self.tree.start[:, node] - first.origin),
                solref=_numbers([_LOOP_STEPS * step, 1.0]),
                solimp=_numbers([_LOOP_IMPEDANCE, _LOOP_IMPEDANCE]),
            )  # fmt: skip

    # ---- ground ----

    def _planes(self, world: Element) -> None:
        """Add a plane for each law, lower by the radius of the balls."""
        radius = _BALL * self.size
        for i, (law, _) in enumerate(self.grounds):
            up = in_space(law.up(self.structure.dimension)[:, None])[:, 0]
            SubElement(
                world, "geom", name=f"ground{i}", type="plane", size=_numbers([0, 0, self.size]),
                pos=_numbers((law.height - radius) * up), zaxis=_numbers(up), contype=str(1 << i),
                conaffinity="0", rgba="0.8 0.8 0.75 1",
            )  # fmt: skip

    def _balls(self, element: Element, node: int, position: FloatArray, inverse: float) -> None:
        """Add a ball for each law that acts on a node.

        MuJoCo's parameters are accelerations, by the inverse mass of the body.
        """
        for i, (law, nodes) in enumerate(self.grounds):
            if node not in nodes:
                continue
            damping = _linear_damping(law, inverse)
            SubElement(
                element, "geom", name=f"ball{node}_{i}", size=_number(_BALL * self.size),
                pos=_numbers(position), mass="0", contype="0", conaffinity=str(1 << i),
                priority="1", condim="3", friction=_numbers([law.friction, 0, 0]),
                solref=_numbers([-law.stiffness * inverse, -damping * inverse]),
                solimp=_numbers([_IMPEDANCE, _IMPEDANCE]),
            )  # fmt: skip
            if damping:
                weight = float(np.linalg.norm(self.load.sum(axis=1))) / 3
                rubs = law.friction * weight / (law.slip_speed * damping)
                steepest = max(float(self.option.get("impratio", "1")), rubs)
                self.option.set("impratio", _number(steepest))

    # ---- strings and loads ----

    def _strings(self) -> None:
        structure = self.structure
        if not len(structure.strings):
            return
        tendons = SubElement(self.root, "tendon")
        paths = structure.paths or structure.strings.tolist()
        for k, path in enumerate(paths):
            named = {"name": f"s{k}", "class": f"string-{structure.string_groups[k]}"}
            tendon = SubElement(tendons, "spatial", named | self._spring(k))
            for node in path:
                SubElement(tendon, "site", site=f"n{node}")
        for k in self.driven:
            start, force = self._actuation(k)
            self._actuator({"name": f"s{k}", "tendon": f"s{k}"} | force, start)

    def _spring(self, k: int) -> dict[str, str]:
        """Return the spring of the tendon of a string."""
        law, held = self.model.strings, float(self.held[k])
        if k in self.driven:
            is_wound = self.actuators == "rest_length"
            return {"springlength": _numbers([0.0, held])} if is_wound else {}
        if self.kind == "force_density":  # T = γ l is a spring without rest length
            return {"stiffness": _number(held), "springlength": _numbers([0.0, 0.0])}
        if isinstance(law, ElasticStrings):
            stiffness = law.axial_rigidity[k] / held
        else:
            assert isinstance(law, LinearStrings)  # others were refused
            stiffness = law.stiffness[k]
        spring = {"stiffness": _number(stiffness), "springlength": _numbers([0.0, held])}
        return spring | ({"damping": _number(law.damping[k])} if law.damping[k] else {})

    def _actuation(self, k: int) -> tuple[float, dict[str, str]]:
        """Return the control at the start and the force law of the actuator of a string."""
        law, held = self.model.strings, float(self.held[k])
        if self.actuators == "force_density":
            return self.force_density[k], _force((0.0, -1.0, 0.0))
        if self.actuators == "tension":
            return self.force_density[k] * self.length[k], _force((-1.0,))
        if isinstance(law, ElasticStrings):
            rigidity = law.axial_rigidity[k]  # T = EA (l/l0 − 1) is linear in 1/l0
            return 1 / held, _force((0.0, -rigidity, 0.0), (rigidity, 0.0, -law.damping[k]))
        assert isinstance(law, LinearStrings)  # others were refused
        return held, _force((law.stiffness[k],), (0.0, -law.stiffness[k], -law.damping[k]))

    def _actuator(self, attributes: dict[str, str], control: float) -> None:
        actuators = self.root.find("actuator")
        if actuators is None:
            actuators = SubElement(self.root, "actuator")
        SubElement(actuators, "general", attributes)
        self.controls.append(float(control))

    def _loads(self) -> None:
        """Add what pushes on nodes all the time: the force of an actuator without control."""
        load = in_space(self.own_load)
        for node in np.flatnonzero(load.any(axis=0)).tolist():
            if node not in self.structure.fixed:
                gear = _numbers([*load[:, node], 0, 0, 0])
                force = _force((0.0,), (1.0, 0.0, 0.0)) | {"forcerange": "0 1"}
                self._actuator(
                    {"name": f"load{node}", "site": f"n{node}", "refsite": "space", "gear": gear}
                    | force,
                    0.0,
                )

    def _keyframe(self, velocities: FloatArray) -> None:
        keyframe = SubElement(self.root, "keyframe")
        arrays: dict[str, Sequence[float] | FloatArray] = {
            "qpos": self.tree.start_coordinates(),
            "qvel": self.tree.joint_velocities(velocities),
            "ctrl": self.controls,
        }
        values = {name: _numbers(array) for name, array in arrays.items() if len(array)}
        SubElement(keyframe, "key", {"name": "start"} | values)


def _flat(law: Any) -> Ground:
    """Return ground that MuJoCo has: a spring on a plane."""
    if not isinstance(law, Ground) or isinstance(law.height, ca.Function):
        raise ValueError(f"MuJoCo's contacts are springs on planes, not {law!r:.60}")
    if law.friction and not law.damping:
        raise ValueError(
            "MuJoCo's contacts rub by their damping, and the ground has none: give it damping"
        )
    return law


def _linear_damping(law: Ground, inverse: float) -> float:
    """Return the linear damping, N s/m, that takes in an impact what that of our law takes."""
    depth = _IMPACT / np.sqrt(4 * law.stiffness * inverse)  # of a bar's end, about
    return float(4 / (3 * np.pi) * law.stiffness * law.damping * depth)


def _force(gain: tuple[float, ...], bias: tuple[float, ...] = ()) -> dict[str, str]:
    """Return the law of an actuator, gain × control + bias, each affine in length and rate."""
    actuator = {"gainprm": _numbers(gain), "forcerange": _numbers(_PULLING)}
    if len(gain) > 1:
        actuator["gaintype"] = "affine"
    return actuator | ({"biastype": "affine", "biasprm": _numbers(bias)} if bias else {})


def _inertial(element: Element, centre: FloatArray, mass: float, inertia: float) -> None:
    SubElement(
        element, "inertial", pos=_numbers(centre), mass=_number(mass),
        diaginertia=_numbers([inertia] * 3),
    )  # fmt: skip


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _numbers(values: Iterable[float]) -> str:
    """Return numbers so that they are read back as they are."""
    return " ".join(_number(value) for value in values)
