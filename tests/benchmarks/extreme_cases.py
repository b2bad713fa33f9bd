"""Stiff and extreme cases for the suite, and the settings at which its methods run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.actuation import to_rest_length
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import (
    ContactLaw,
    Ground,
    HertzGround,
    LinearStrings,
    Model,
    SmoothGround,
)
from tenscontrol.integrate.integrator import largest_frequency
from tenscontrol.integrate.methods import METHODS
from tenscontrol.library import class2_tower, d_bar, six_bar_ball, spine
from tenscontrol.simulation import Scene
from tenscontrol.statics import prestress, prism_force_density
from tenscontrol.structure import Structure, prism, segment_counts, spread_force_density, subdivide

#: Error that a method is asked for, as part of the size of the structure.
ASKED = 1e-3

#: Tolerance of the methods that choose their steps: error allowed a step.
TOLERANCE = 1e-6

# The method that takes either, with a step.
_STEPPED = "energy_momentum, step"

# Steps as angles that the fastest motion turns through, rad, and about how many evaluations a step
# takes.
_ANGLES = {"rk4": 0.1, _STEPPED: 0.03}
_EVALUATIONS = {"rk4": 4, _STEPPED: 8}

# About how many evaluations the others take for a radian of the fastest motion, where they follow
# it. The energy-momentum method by tolerance does not follow what is smaller than its tolerance.
_BY_RADIAN = {"dop853": 4.0, "cvodes": 20.0}

# What an evaluation of these costs, by that of the explicit ones: linear systems.
_COST = {_STEPPED: 3.0}

# Nodes for which the budget is meant.
_NODES = 6

# m/s², of what falls.
_GRAVITY = 9.81

# Part of the force that balances which the vertical strings start with.
_LET_GO = 0.9


@dataclass(frozen=True, eq=False)
class Extreme:
    """A motion with something extreme about it: ``group`` says what, ``label`` how much.

    Fixed steps are ``longer`` times too long. Motions are compared at ``outputs`` times. Steps must
    also follow ``turning``, the largest speed of turning, rad/s. A run that costs more than
    ``budget`` evaluations of a prism by explicit methods is not run. ``closed_form`` returns nodes,
    m, shape (d, n, T), over time where the motion is known.
    """

    group: str
    label: str
    case: Scene
    longer: float = 1.0
    outputs: int = 100
    turning: float = 0.0
    budget: float = 3e5
    closed_form: Callable[[FloatArray], FloatArray] | None = None

    @property
    def name(self) -> str:
        """Group and label."""
        return f"{self.group}: {self.label}"

    @property
    def time(self) -> FloatArray:
        """The times at which motions are compared, s, shape (outputs,)."""
        return self.case.duration * np.arange(1, self.outputs + 1) / self.outputs

    @cached_property
    def frequency(self) -> float:
        """Largest of the frequencies of strings and contacts and the speeds of turning, rad/s."""
        case = self.case
        strings = 0.0
        if case.model.contacts is not None:
            strings = fastest_rate(case)
        elif len(case.structure.strings):
            strings = largest_frequency(case.equation(), case.state, case.input_value)
        return float(max(strings, self.turning, 1.0 / case.duration))

    @property
    def angle(self) -> float:
        """What the fastest motion turns through in all, rad."""
        return self.frequency * self.case.duration

    def settings(self, method: str) -> dict[str, float]:
        """Return what ``simulate`` is given for a method: ``step`` or ``tolerance``."""
        if method in _ANGLES:
            return {"step": self.longer * _ANGLES[method] / self.frequency}
        return {"tolerance": TOLERANCE}

    def evaluations(self, method: str) -> float:
        """Return about how many evaluations a method needs; 0 if it need not follow the fastest."""
        if method in _ANGLES:
            return _EVALUATIONS[method] * self.angle / (self.longer * _ANGLES[method])
        return _BY_RADIAN.get(method, 0.0) * self.angle

    def allowed(self, method: str) -> float:
        """Return how many evaluations a method may take."""
        larger: float = max(1.0, self.case.nodes.shape[1] / _NODES)
        return self.budget / (_COST.get(method, 1.0) * larger)


def methods() -> tuple[str, ...]:
    """Return the names of what the suite runs: every method, and the automatic choice.

    Not rk4_plain, which is for errors above those that the suite asks for.
    """
    return (*(name for name in METHODS if name != "rk4_plain"), _STEPPED, "auto")


def extremes(quick: bool = False) -> tuple[Extreme, ...]:
    """Return the cases; if ``quick`` a few only, one of each kind that is soon done."""
    return tuple(_few() if quick else (case for make in _ALL for case in make()))


def _let_go(
    structure: Structure,
    level: float,
    stiffness: Any = None,
    duration: float = 1.0,
    spin: float = 0.0,
) -> Scene:
    """Return a prism let go with too little force in its vertical strings, turning as a whole."""
    parent = structure if structure.parent is None else structure.parent
    gamma = prism_force_density(3, level)[0].copy()
    gamma[np.asarray(parent.string_groups) == "vertical"] *= _LET_GO
    turning = np.cross([0.0, 0.0, spin], structure.nodes.T).T
    if structure.parent is not None:
        gamma = spread_force_density(structure, gamma)
    if stiffness is None:
        return Scene(Model(structure), duration, velocities=turning, force_density=gamma)
    model = Model(structure, strings=LinearStrings(stiffness=stiffness))
    lengths = to_rest_length(model, structure.nodes, gamma).rest_length
    return Scene(model, duration, velocities=turning, rest_length=lengths)


def _stiffness(powers: range = range(10)) -> Iterator[Extreme]:
    for power in powers:
        k = 10.0**power
        level = min(10.0, 0.2 * k)
        # The truth of the stiffest takes long.
        case = _let_go(prism(), level, k, 2.0 if k < 1e7 else 0.5, spin=1.0)
        yield Extreme("string stiffness", f"1e{power} N/m", case, turning=1.0)


def _node_mass(masses: tuple[float, ...] = (1e-6, 1e-4, 1e-2, 1.0)) -> Iterator[Extreme]:
    for mass in masses:
        cut = subdivide(prism(), segments=2, node_mass=mass)
        case = _let_go(cut, 10.0, 100.0 * segment_counts(cut), 0.25 if mass < 1e-3 else 1.0)
        yield Extreme("string-node mass", f"{mass:g} kg beside 1 kg", case)


def _bar_mass() -> Iterator[Extreme]:
    case = _let_go(prism(bar_mass=[1e-3, 1.0, 1e3]), 10.0, 100.0, 2.0)
    yield Extreme("bars", "1e-3, 1 and 1e3 kg in one", case)


def _segments() -> Iterator[Extreme]:
    counts = [64] + [1] * 8
    cut = subdivide(prism(), segments=counts, string_mass=[0.01] + [0.0] * 8)
    case = _let_go(cut, 10.0, 100.0 * segment_counts(cut), 0.3)
    yield Extreme("segments", "64 in a string", case)


def _free_bar(speeds: tuple[float, ...] = (1.0, 10.0, 100.0, 1e3)) -> Iterator[Extreme]:
    """Return a bar that turns about its centre and drifts: three turns."""
    for speed in speeds:
        bar = Structure(
            nodes=[[-0.5, 0.5], [0.0, 0.0], [0.0, 0.0]],
            bars=[[0, 1]],
            strings=np.zeros((0, 2), int),
            bar_mass=1.0,
        )
        drift = np.array([[0.1], [0.2], [0.3]]) * speed
        turning = np.cross([0.0, 0.0, speed], bar.nodes.T).T

        def motion(time: FloatArray, speed: float = speed, drift: FloatArray = drift) -> FloatArray:
            half = 0.5 * np.array([np.cos(speed * time), np.sin(speed * time), 0 * time])
            ends = np.stack([-half, half], axis=1)
            return np.asarray(ends + drift[:, :, None] * time)

        case = Scene(
            Model(bar),
            6 * np.pi / speed,
            velocities=turning + drift,
            force_density=np.zeros(0),
        )
        yield Extreme(
            "free bar turning", f"{speed:g} rad/s", case, turning=speed, closed_form=motion
        )


def _spun_prism(speeds: tuple[float, ...] = (100.0, 1e3)) -> Iterator[Extreme]:
    for speed in speeds:
        # Strings that hold it together: five times as fast as it turns.
        case = _let_go(prism(), 10.0, 25 * speed**2, 12.0 / speed, spin=speed)
        yield Extreme("prism turning", f"{speed:g} rad/s", case, turning=speed)


def _prestress(levels: tuple[float, ...] = (1e-6, 1e-3, 1.0, 1e3, 1e6)) -> Iterator[Extreme]:
    for level in levels:
        period = 2 * np.pi / np.sqrt(level)
        held = _let_go(prism(), level, None, period)
        elastic = _let_go(prism(), level, 100 * level, period)
        yield Extreme("prestress, held", f"{level:g} N/m", held)
        yield Extreme("prestress, elastic", f"{level:g} N/m", elastic)
    weak = _let_go(prism(), 1e-3, 1e4, 100.0)
    yield Extreme("prestress, elastic", "1e-3 N/m in 1e4 N/m", weak)


def _slack() -> Iterator[Extreme]:
    """All strings slack: for ever; until they catch the bars, which fly apart; again and again."""
    structure = prism()
    model = Model(structure, strings=LinearStrings(stiffness=1e3))
    bars = structure.bars
    # Every bar moves as one body: away from the axis, and turning about its centre.
    centres = structure.nodes[:, bars].mean(axis=2)
    away = np.zeros_like(structure.nodes)
    for (start, end), centre in zip(bars, centres.T, strict=True):
        away[:2, [start, end]] = centre[:2, None]
        for node in (start, end):
            away[:, node] += np.cross([0.3, 0.0, 1.0], structure.nodes[:, node] - centre)
    lengths = structure.string_length()
    kinds = (("for ever", 100.0, 2.0), ("until they catch", 1.05, 2.0), ("rattling", 1.05, 8.0))
    for label, part, duration in kinds:
        case = Scene(model, duration, velocities=away, rest_length=part * lengths)
        yield Extreme("all strings slack", label, case, turning=1.0)


def _zero_length() -> Iterator[Extreme]:
    """Two bars whose ends a string pulls together: from a distance of nothing, and through it."""
    nodes = np.array([[0.0, 1.0, 0.0, -1.0], [0.0, 0.0, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0]])
    joined = Structure(nodes=nodes, bars=[[0, 1], [2, 3]], strings=[[0, 2], [1, 3]], bar_mass=1.0)
    # The bars part at right angles to themselves, with a speed that no bar resists.
    parting = np.zeros((3, 4))
    parting[2] = [0.5, 0.0, -0.5, 0.0]
    held = Scene(Model(joined), 4.0, velocities=parting, force_density=np.array([10.0, 0.5]))
    yield Extreme("string at zero length", "force density held", held)
    apart = nodes.copy()
    apart[2, 2:] += 0.2
    crossing = Structure(nodes=apart, bars=joined.bars, strings=joined.strings, bar_mass=1.0)
    model = Model(crossing, strings=LinearStrings(stiffness=[50.0, 1.0]))
    for rest in (0.1, 1e-3):
        case = Scene(model, 3.0, rest_length=np.array([rest, 1.5]))
        yield Extreme("string through zero length", f"rest length {rest:g} m", case)


def _aspect(aspects: tuple[float, ...] = (1e-3, 1e-1, 1e1, 1e3)) -> Iterator[Extreme]:
    for aspect in aspects:
        # Radius 1 and height `aspect`, or the longer of the two 1.
        scale = max(aspect, 1.0)
        structure = prism(radius=0.5 / scale, height=aspect / scale)
        word = "needle" if aspect > 1 else "coin"
        case = _let_go(structure, 10.0, 100.0, 2.0)
        yield Extreme(word, f"height/width {aspect:g}", case)


def _long_steps(factors: tuple[float, ...] = (10.0, 30.0, 100.0)) -> Iterator[Extreme]:
    for factor in factors:
        for k in (100.0, 1e4):
            case = _let_go(prism(), 10.0, k, 4.0, spin=1.0)
            group = f"steps {factor:g} times too long"
            # Few outputs, for steps are shortened to reach them.
            yield Extreme(group, f"{k:g} N/m", case, longer=factor, outputs=10)


def _many_steps() -> Iterator[Extreme]:
    """Return a run some three hundred times as long as the others."""
    case = _let_go(prism(), 10.0, 100.0, 560.0)
    yield Extreme("long run", "560 s", case, budget=1.2e6)


def _scale() -> Iterator[Extreme]:
    """Return the same motion at sizes from microns to kilometres."""
    # Masses, forces and times fit the size.
    for length, label in ((1e-6, "1 µm"), (1e-3, "1 mm"), (1e3, "1 km")):
        structure = prism(radius=0.5 * length, height=length, bar_mass=length**3)
        # Density and speeds of sound as they are: mass L³, stiffness L, time L.
        case = _let_go(structure, 10.0 * length, 100.0 * length, 2.0 * length, spin=1.0 / length)
        yield Extreme("scale", label, case, turning=1.0 / length)


def _damped() -> Iterator[Extreme]:
    """Damped strings, whose energy tells nothing."""
    base = _let_go(prism(), 10.0, 100.0, 2.0)
    for damping, longer in ((1.0, 1.0), (100.0, 1.0), (1.0, 10.0), (1.0, 30.0)):
        model = Model(base.structure, strings=LinearStrings(stiffness=100.0, damping=damping))
        label = f"{damping:g} N s/m"
        if longer > 1:
            label += f", steps {longer:g} times too long"
        case = replace(base, model=model)
        yield Extreme("damped", label, case, longer, 10 if longer > 1 else 100)


def _class_2_tower() -> Iterator[Extreme]:
    """Two twisted prisms, the upper on the nodes of the lower, let go as :func:`_let_go`."""
    ring = np.arange(3)
    angles = [2 * np.pi * ring / 3 + np.pi / 6 * (level % 2) for level in range(3)]
    nodes = np.hstack(
        [0.5 * np.array([np.cos(a), np.sin(a), 2.0 * k + 0 * a]) for k, a in enumerate(angles)]
    )
    bars = [(i, 3 + (i + 1) % 3) for i in ring] + [(3 + i, 6 + (i - 1) % 3) for i in ring]
    around = [(3 * k + i, 3 * k + (i + 1) % 3) for k in range(3) for i in ring]
    along = [(3 * k + i, 3 * k + 3 + i) for k in range(2) for i in ring]
    tower = Structure(nodes, bars, along + around, bar_mass=1.0)
    # At rest as two prisms are; the ring in between belongs to both.
    gamma = 10.0 * np.repeat([np.sqrt(3) * _LET_GO, 1.0, 2.0, 1.0], [6, 3, 3, 3])
    for k, duration in ((1e2, 1.0), (1e6, 0.2)):
        model = Model(tower, strings=LinearStrings(stiffness=k))
        lengths = to_rest_length(model, nodes, gamma).rest_length
        case = Scene(model, duration, rest_length=lengths)
        yield Extreme("class-2 tower", f"{k:g} N/m", case)


def _spine() -> Iterator[Extreme]:
    """Vertebrae of five nodes and ten bars, one more than hold them, on one that is fixed."""
    tips = np.array([[1, -1, 0, 0, 0], [0, 0, 1, -1, 0], [-1, -1, 1, 1, 0]]) * 0.15
    nodes = np.hstack([tips + np.array([[0.0], [0.0], [0.2 * k]]) for k in range(3)])
    bars = [(5 * k + i, 5 * k + j) for k in range(3) for i in range(5) for j in range(i + 1, 5)]
    joints = [(i, 5 + i) for i in range(4)] + [(i, 5 + j) for i in (2, 3) for j in (0, 1)]
    strings = [(5 * k + i, 5 * k + j) for k in range(2) for i, j in joints]
    spine = Structure(nodes, bars, strings, bar_mass=0.02, fixed=np.arange(5))
    for k in (1e2, 1e4):
        model = Model(spine, strings=LinearStrings(stiffness=k), gravity=9.81)
        value = (1 - 5 / k) * spine.string_length()
        case = Scene(model, 0.3, rest_length=value)
        yield Extreme("spine of redundant bars", f"{k:g} N/m", case)


def _chain() -> Iterator[Extreme]:
    """Return a chain in the plane that falls from the level, held at one end."""
    count = 20
    nodes = np.vstack([np.linspace(0.0, 1.0, count + 1), np.zeros(count + 1)])
    bars = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    no_strings = np.zeros((0, 2), int)
    for light in (1.0, 1e-6):
        mass = np.where(np.arange(count) % 2, 1.0, light)
        chain = Structure(nodes, bars, no_strings, bar_mass=mass, fixed=[0])
        case = Scene(Model(chain, gravity=9.81), 0.3, force_density=np.zeros(0))
        yield Extreme("chain of 20 bars", f"{light:g} beside 1 kg", case)


def _short_segment() -> Iterator[Extreme]:
    """Return a string over three nodes, two of which are close and part."""
    for gap in (1e-3, 1e-6):
        nodes = np.array([[0.0, 1.0, 0.0, -1.0], [0.0, 0.0, 0.0, 0.2], [0.0, 0.0, gap, 0.0]])
        paths = [(0, 2, 1), (1, 3)]
        crossing = Structure(nodes, bars=[[0, 1], [2, 3]], strings=paths, bar_mass=1.0)
        model = Model(crossing, strings=LinearStrings(stiffness=[50.0, 1.0]))
        # Across the bar of the node, but for what the gap turns it.
        b = nodes[:, 2] - nodes[:, 3]
        up = np.array([0.0, 0.0, 1.0]) - b[2] / (b @ b) * b
        parting = np.outer(up, [0.0, 0.0, 0.5, 0.0])
        case = Scene(model, 1.0, velocities=parting, rest_length=np.array([0.9, 1.5]))
        yield Extreme("segment of a string", f"{gap:g} m", case)


def _d_bar() -> Iterator[Extreme]:
    """Return a rhombus in the plane: one string is slack while the other pulls, by turns."""
    nodes = np.array([[0.0, 0.6, 0.0, -0.6], [-0.8, 0.0, 0.8, 0.0]])
    bars = [[0, 1], [1, 2], [2, 3], [3, 0]]
    d_bar = Structure(nodes, bars, strings=[[1, 3], [0, 2]], bar_mass=1.0)
    for k in (1e2, 1e4):
        model = Model(d_bar, strings=LinearStrings(stiffness=k))
        value = np.array([1.2 - 10 / k, 1.6 + 1 / k])
        case = Scene(model, 2.0, rest_length=value)
        yield Extreme("D-bar through slack", f"{k:g} N/m", case)


# ---- on the ground ----


def _dropped(
    structure: Structure | None = None,
    stiffness: float = 1e4,
    height: float = 0.1,
    duration: float = 0.5,
    spin: float = 0.0,
    string_damping: float = 0.5,
    ground: type[ContactLaw] = Ground,
    **law: Any,
) -> Scene:
    """Return a prism that stands askew above the ground, let go with a speed sideways.

    ``height`` is that of its lowest node, by its size of 1 m. Masses are 1 kg a bar.
    """
    at = _askew(prism() if structure is None else structure)
    gamma = prism_force_density(3, 10.0)[0]
    strings = LinearStrings(stiffness=100.0, damping=string_damping)
    lengths = to_rest_length(Model(at, strings=strings), at.nodes, gamma).rest_length
    given = {"damping": 0.3, "friction": 0.5} | law
    floor = ground(stiffness, height=at.nodes[2].min() - height, **given)
    model = Model(at, strings=strings, gravity=_GRAVITY, ground=floor)
    centre = at.nodes.mean(axis=1, keepdims=True)
    moving = np.cross([spin, 0.0, spin], (at.nodes - centre).T).T
    moving[0] += 0.5
    return Scene(model, duration, velocities=moving, rest_length=lengths)


def _askew(structure: Structure) -> Structure:
    """Return the structure turned, so that no two nodes are at one height."""
    a, b = 0.3, 0.2
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return replace(structure, nodes=about_y @ about_x @ structure.nodes)


def _ground_stiffness(powers: range = range(2, 10)) -> Iterator[Extreme]:
    for power in powers:
        case = _dropped(stiffness=10.0**power, duration=0.4 if power < 7 else 0.2)
        yield Extreme("ground stiffness", f"1e{power} N/m", case)


def _ground_without_loss() -> Iterator[Extreme]:
    """Ground that gives back all that it takes: prism and bar bounce again and again."""
    for power in (3, 6):
        case = _dropped(
            stiffness=10.0**power, duration=1.0, string_damping=0.0, damping=0.0, friction=0.0
        )
        yield Extreme("ground without loss", f"1e{power} N/m", case)
    nodes = np.array([[-0.5, 0.5], [0.0, 0.0], [0.1, 0.1]])
    bar = Structure(nodes, [[0, 1]], np.zeros((0, 2), int), 2.0)
    model = Model(bar, gravity=_GRAVITY, ground=Ground(1e4))
    case = Scene(model, 10.0, force_density=np.zeros(0))
    yield Extreme("ground without loss", "a bar bounces for 10 s", case)


def _ground_mass() -> Iterator[Extreme]:
    for masses in ([1e-3, 1.0, 1.0], [1e-3, 1.0, 1e3]):
        case = _dropped(prism(bar_mass=masses), stiffness=1e4)
        label = ", ".join(f"{mass:g}" for mass in masses)
        yield Extreme("bars on the ground", f"{label} kg in one", case)


def _drop_height(heights: tuple[float, ...] = (1e-3, 1e-1, 1e1, 1e3)) -> Iterator[Extreme]:
    for height in heights:
        falls = float(np.sqrt(2 * height / _GRAVITY))
        yield Extreme("drop", f"{height:g} sizes", _dropped(height=height, duration=falls + 0.3))


def _friction(values: tuple[float, ...] = (0.0, 0.1, 1.0, 5.0)) -> Iterator[Extreme]:
    for friction in values:
        yield Extreme("friction", f"{friction:g}", _dropped(friction=friction))
    sticks = _dropped(friction=0.5, slip_speed=1e-5)
    yield Extreme("friction", "slip speed 1e-5 m/s", sticks)


def _resting() -> Iterator[Extreme]:
    """Nodes that rest on the ground, stick to it, and press for a minute."""
    for power in (3, 5):
        case = _dropped(
            stiffness=10.0**power, height=1e-3, duration=60.0, damping=1.0, string_damping=5.0
        )
        yield Extreme("rest for 60 s", f"1e{power} N/m", case, budget=1e6)


def _spinning_drop(speeds: tuple[float, ...] = (10.0, 100.0)) -> Iterator[Extreme]:
    for speed in speeds:
        case = _dropped(spin=speed / np.sqrt(2), duration=0.3)
        yield Extreme("spinning drop", f"{speed:g} rad/s", case, turning=speed)


def _ground_laws() -> Iterator[Extreme]:
    yield Extreme("ground law", "Hertz", _dropped(stiffness=1e5, ground=HertzGround))
    yield Extreme("ground law", "smooth", _dropped(ground=SmoothGround))
    yield Extreme("ground law", "damping 30 s/m", _dropped(damping=30.0))
    case = _dropped()
    wall = Ground(1e4, damping=0.3, friction=0.5, normal=np.array([-1.0, 0.0, 0.3]), height=-0.6)
    model = Model(
        case.structure,
        strings=case.model.strings,
        gravity=_GRAVITY,
        ground=[*case.model.ground, wall],
    )
    yield Extreme("ground law", "a corner", replace(case, model=model))


def _dropped_others() -> Iterator[Extreme]:
    """Return drops of structures of the library, with bars that share nodes, and in the plane."""
    for make in (six_bar_ball, class2_tower, d_bar, spine):
        structure = make()
        if len(structure.fixed_rows):
            structure = replace(structure, fixed=np.zeros(0, int))
        gamma = prestress(structure, 30.0).force_density
        strings = LinearStrings(stiffness=1e3, damping=0.5)
        lengths = to_rest_length(Model(structure, strings=strings), structure.nodes, gamma)
        below = float(structure.nodes[-1].min()) - 0.1
        floor = Ground(5e3, damping=0.3, friction=0.5, height=below)
        moving = np.zeros_like(structure.nodes)
        moving[0] = 0.5
        case = Scene(
            Model(structure, strings=strings, gravity=_GRAVITY, ground=floor),
            0.4,
            velocities=moving,
            rest_length=lengths.rest_length,
        )
        yield Extreme("drop of another structure", make.__name__, case)


def _grazing() -> Iterator[Extreme]:
    """Return a bar that turns, and whose end just reaches the ground, again and again."""
    for turned in (next(_free_bar((10.0,))),):
        above = np.array([0.0, 1.0, 0.0])  # it turns in the plane of x and y
        start = turned.case
        along = start.velocities - start.velocities.mean(axis=1, keepdims=True)
        ground = Ground(1e5, friction=0.5, normal=above, height=-0.5)
        case = replace(start, model=Model(start.structure, ground=ground), velocities=along)

        def motion(time: FloatArray) -> FloatArray:
            half = 0.5 * np.array([np.cos(10 * time), np.sin(10 * time), 0 * time])
            return np.stack([-half, half], axis=1)

        yield Extreme("grazing", "a bar at 10 rad/s", case, turning=10.0, closed_form=motion)


def _ground_scale() -> Iterator[Extreme]:
    """Return the same drop at sizes from microns to kilometres."""
    for length, label in ((1e-6, "1 µm"), (1e3, "1 km")):
        case = _dropped()
        strings, floor = case.model.strings, case.model.ground[0]
        structure = replace(
            case.structure, nodes=length * case.nodes, bar_mass=length**3 * np.ones(3)
        )
        # Time goes with the length, speeds stay.
        model = Model(
            structure,
            strings=LinearStrings(stiffness=100.0 * length, damping=0.5 * length**2),
            gravity=_GRAVITY / length,
            ground=replace(floor, stiffness=1e4 * length, height=length * float(floor.height)),
        )
        assert strings is not None  # of a prism
        scaled = Scene(
            model,
            length * case.duration,
            velocities=case.velocities,
            rest_length=length * case.input_value,
        )
        yield Extreme("drop of another scale", label, scaled)


_ALL = (
    _stiffness, _node_mass, _bar_mass, _segments, _free_bar, _spun_prism, _prestress, _slack,
    _zero_length, _aspect, _long_steps, _damped, _many_steps, _scale, _class_2_tower, _spine,
    _chain, _short_segment, _d_bar, _ground_stiffness, _ground_without_loss, _ground_mass,
    _drop_height, _friction, _resting, _spinning_drop, _ground_laws, _dropped_others, _grazing,
    _ground_scale,
)  # fmt: skip


def _few() -> Iterator[Extreme]:
    yield from _stiffness(range(2, 3))
    yield from _free_bar((1e3,))
    yield next(_prestress((1e-6,)))
    yield next(_long_steps((30.0,)))
    yield next(_zero_length())
    yield next(_d_bar())
    yield Extreme("ground stiffness", "1e4 N/m", _dropped(height=0.01, duration=0.1))
    yield from _grazing()
