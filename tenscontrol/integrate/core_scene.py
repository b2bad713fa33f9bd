"""Equations of motion as the compiled core runs them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref, c_void_p
from itertools import accumulate
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.core import records
from tenscontrol.core.library import library
from tenscontrol.core.records import GROUND_NUMBERS, pointers
from tenscontrol.dynamics.contact_laws import ContactLaw, Ground, HertzGround, SmoothGround
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.forms.elimination import Elimination
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings
from tenscontrol.structure.structure import Structure

# In the order of the core's own numbers for them.
_GROUNDS = (Ground, HertzGround, SmoothGround)
_LAWS = (type(None), LinearStrings, ElasticStrings)

# Steps in a call at most, and the parts that switches may cut one into.
_MOST_STEPS, _PARTS = 2**30, 10

# What has its memory by the count of stages alone.
_ONE_STAGE = records.Tableau(1)


def core_scene(equation: Equation) -> CoreScene | None:
    """Return an equation as the core runs it, kept with it; None where there is no core for it.

    The core knows the forces of this package: strings by its laws, flat grounds, loads.
    """
    if library() is None:
        return None
    known: tuple[CoreScene | None] = equation.prepared.get(
        "core", lambda: (CoreScene(equation) if _is_known(equation) else None,)
    )
    return known[0]


def _is_known(equation: Equation) -> bool:
    forces = equation.forces
    layout = equation.layout
    if forces is None or type(forces.law) not in _LAWS or layout.parameters:
        return False
    if any(term is not forces.contacts for term in forces.terms):
        return False
    return all(
        type(law) in _GROUNDS and not isinstance(law.height, ca.Function)
        for law, _, _ in forces.contacts or ()
    )


def numbers_of_grounds(laws: Sequence[ContactLaw]) -> FloatArray:
    """Return the numbers of contact laws, one row a law, shape (laws, numbers)."""
    rows = [[float(getattr(law, name, 0.0)) for name in GROUND_NUMBERS] for law in laws]
    return np.reshape(np.array(rows, dtype=float), (len(laws), len(GROUND_NUMBERS)))


class CoreScene:
    """The tables of an equation, and what the core makes of states by them.

    Parameters
    ----------
    equation : Equation
        One that :func:`core_scene` takes.
    """

    def __init__(self, equation: Equation) -> None:
        core = library()
        assert core is not None  # else there is nothing to make
        self.core = core
        layout = equation.layout
        self._degree = layout.degree
        self._of_inputs = (
            layout.count, layout.degree, layout.load > 0, layout.offset > 0, layout.lengths > 0
        )  # fmt: skip
        self._arrays: list[Any] = []  # that the records point to
        structure = equation.structure
        assert structure is not None  # it has forces
        self.states = 2 * len(structure.free_rows)
        self.switches = equation.switches
        self.scene, self.lengths = records.Scene(), records.Lengths()
        self.at, self.lengths_at = byref(self.scene), byref(self.lengths)  # as the core takes them
        # Places of entries among those that are free.
        is_free = np.isin(np.arange(structure.nodes.size), structure.free_rows)
        free_place = np.cumsum(is_free) - 1
        self._put_counts(equation, structure)
        self._put_nodes(equation, structure)
        self._put_strings(equation, structure)
        self._put_bars(structure, free_place)
        self._put_grounds(equation, structure.dimension)
        if structure.blocks:
            self._put_blocks(Elimination(structure), structure.dimension)
        self._put_lengths(structure, free_place)
        if equation.layout.lengths:
            self._put("free_bar", structure.free_bars)
            self._put("swinging_bar", structure.swinging_bars)
            independent = [block.independent for block in structure.blocks]
            self._put("block_bar", np.concatenate([np.zeros(0, dtype=int), *independent]))
        self.work_size = core.tc_motion_work_size(self.at, byref(self.drive(np.zeros(0))))
        # In the memory of a motion: the state, what pulls, its slope, what a step may err, work.
        sizes = self.states, self.switches, self.states, self.states, self.work_size
        ends = list(accumulate(sizes))
        self.memory_size, self.places = ends[-1], [8 * end for end in (0, *ends[:-1])]

    # ---- tables ----

    def _put_counts(self, equation: Equation, structure: Structure) -> None:
        law = equation.law
        slacking = 0 if law is None else len(structure.strings)
        counts = {
            "dimension": structure.dimension, "entries": structure.nodes.size,
            "free": len(structure.free_rows), "law": _LAWS.index(type(law)),
            "damped": law is not None and law.is_damped, "strings": len(structure.strings),
            "segments": len(structure.segments), "clustered": structure.has_clusters,
            "slacking": slacking, "switches": equation.switches,
            "free_bars": len(structure.free_bars), "swinging_bars": len(structure.swinging_bars),
            "points": len(structure.string_nodes), "bars": len(structure.bars),
        }  # fmt: skip
        for name, count in counts.items():
            setattr(self.scene, name, int(count))
        size = structure.size
        self.scene.size, self.scene.shortest = size, 1e-12 * size

    def _put_nodes(self, equation: Equation, structure: Structure) -> None:
        if len(structure.fixed_rows):
            self._put("free_row", structure.free_rows)
        self._put("place", structure.nodes.ravel(order="F"))
        if equation.load is not None:
            self._put("load", equation.load.ravel(order="F"))
        self._put("point", structure.dimension * structure.string_nodes)
        self._put("point_inverse_mass", 1 / structure.string_node_mass)
        self._put("point_mass", structure.point_mass)

    def _put_strings(self, equation: Equation, structure: Structure) -> None:
        law = equation.law
        self._put("segment_start", structure.dimension * structure.segments[:, 0])
        self._put("segment_end", structure.dimension * structure.segments[:, 1])
        self._put("segment_string", structure.segment_string)
        self._put("segment_row", 4 * structure.segments)
        if isinstance(law, (LinearStrings, ElasticStrings)):
            stiffness = law.axial_rigidity if isinstance(law, ElasticStrings) else law.stiffness
            self._put("stiffness", stiffness)
            self._put("damping", law.damping)

    def _put_bars(self, structure: Structure, free_place: IntArray) -> None:
        d = structure.dimension
        self._put("any_start", d * structure.bars[:, 0])
        self._put("any_end", d * structure.bars[:, 1])
        self._put("bar_mass", structure.bar_mass)
        ends, mass = structure.bars[structure.free_bars], structure.bar_mass[structure.free_bars]
        self._put("bar_start", d * ends[:, 0])
        self._put("bar_end", d * ends[:, 1])
        self._put("bar_row", free_place[d * ends])
        constants = [0.5 * (2 / mass), 3 / mass, mass / 12, 6 / mass]
        self._put("bar_constants", np.stack(constants, axis=1))
        hinge, tip = structure.hinged_pairs.T
        mass = structure.bar_mass[structure.swinging_bars]
        self._put("hinge", d * hinge)
        self._put("tip", d * tip)
        self._put("tip_row", free_place[d * tip])
        self._put("tip_constants", np.stack([mass / 3, 3 / mass], axis=1))

    def _put_grounds(self, equation: Equation, d: int) -> None:
        grounds, laws = [], []
        for law, nodes, switch in equation.contacts or ():
            ground = records.Ground()
            ground.kind = _GROUNDS.index(type(law))
            ground.count = len(nodes)
            ground.first_switch = -1 if switch is None else switch.start
            self._put("node", d * nodes, ground)
            ground.damped, ground.rubs = law.damping > 0, law.friction > 0
            laws.append(law)
            ground.normal[:d] = law.up(d).tolist()
            grounds.append(ground)
        self.scene.grounds = len(grounds)
        self._put("ground_numbers", numbers_of_grounds(laws))
        self.scene.ground = self._array_of(records.Ground, grounds)

    def _put_blocks(self, elimination: Elimination, d: int) -> None:
        scene, tables, sizes = self.scene, elimination.tables, elimination.sizes
        assembly = elimination.assembly
        scene.factors, scene.unknowns = sizes["FACTORS"], sizes["UNKNOWNS"]
        scene.block_rows, scene.block_bars = sizes["BLOCK_ROWS"], assembly.count
        starts, ends = (assembly.reads[f"p_{end}"].at for end in ("start", "end"))
        assert starts is not None  # bars have nodes
        assert ends is not None  # at both ends
        to_end, to_start, right = assembly.writes
        self._put("block_start", d * starts)
        self._put("block_end", d * ends)
        self._put("entry_end", to_end.at)
        self._put("entry_start", to_start.at)
        self._put("right_place", right.at)
        for name in (
            "block_mass", "factor_row", "factor_first", "factor_pair", "block_row", "block_place"
        ):  # fmt: skip
            self._put(name, tables[name])

    def _put_lengths(self, structure: Structure, free_place: IntArray) -> None:
        d, lengths, length = structure.dimension, self.lengths, structure.bar_length
        self._put("bar_length", length[structure.free_bars], lengths)
        self._put("tip_length", length[structure.swinging_bars], lengths)
        if structure.blocks:
            bars = np.concatenate([block.independent for block in structure.blocks])
            rows = np.concatenate([block.rows for block in structure.blocks])
            self._put("block_length", length[bars], lengths)
            self._put("block_free", free_place[rows], lengths)
        bodies = []
        for block in structure.blocks:
            is_held = np.isin(structure.bars[block.bars], structure.fixed).any()
            if is_held or len(block.rows) < d * len(block.nodes):
                continue
            body = records.Body(len(block.bars), len(block.nodes))
            ends = free_place[d * structure.bars[block.bars]]
            self._put("start", ends[:, 0], body)
            self._put("end", ends[:, 1], body)
            self._put("bar_mass", structure.bar_mass[block.bars], body)
            self._put("node", free_place[d * block.nodes], body)
            self._put("point_mass", structure.point_mass[block.nodes], body)
            bodies.append(body)
        lengths.bodies, lengths.body = len(bodies), self._array_of(records.Body, bodies)
        self._arrays.append(length)
        self._bar_length = pointers(length)[0]

    def _put(self, name: str, values: Any, record: Any = None) -> None:
        kind = np.int32 if np.asarray(values).dtype.kind in "iub" else np.float64
        array = np.ascontiguousarray(values, dtype=kind)
        self._arrays.append(array)
        setattr(self.scene if record is None else record, name, records.address(array))

    def _array_of(self, kind: type[Any], entries: list[Any]) -> int:
        array = (kind * max(1, len(entries)))(*entries)
        self._arrays.append(array)
        return ctypes.addressof(array)

    # ---- calls ----

    def drive(self, u: FloatArray) -> records.Drive:
        """Return the record of an input u."""
        begin = float(u[-1]) if self._degree and len(u) else 0.0
        return records.Drive(records.address(u), begin, *self._of_inputs)

    def largest_force(self, state: FloatArray, u: FloatArray) -> float:
        """Return the largest force on a free entry in a state, N."""
        taut, slope = np.zeros(self.switches), np.empty(self.states)
        work = np.empty(self.work_size)
        force = self.core.tc_begin(
            self.at, byref(self.drive(u)), *pointers(state, taut, slope, work),
        )  # fmt: skip
        return float(force)

    def slope(self, state: FloatArray, u: FloatArray, taut: FloatArray) -> FloatArray:
        """Return ẋ for fixed switches, shape (states,)."""
        slope, work = np.empty(self.states), np.empty(self.work_size)
        self.core.tc_slope(
            self.at, byref(self.drive(u)), *pointers(state, taut, slope, work),
        )  # fmt: skip
        return slope

    def slopes(self, states: FloatArray, u: FloatArray, taut: FloatArray) -> FloatArray:
        """Return ẋ for fixed switches, shape (states, T), of states, inputs, switches as columns.

        Supports stand, and no bar is driven.
        """
        count, half = states.shape[1], self.states // 2
        rows = [np.ascontiguousarray(array.T) for array in (states, u, taut)]
        lengths, accelerations = np.zeros(count), np.empty((count, half))
        steps = records.Steps(count, *map(records.address, (lengths, *rows)))
        given = self.at, byref(self.drive(rows[1][0]))
        size = self.core.tc_variations_work_size(*given, byref(_ONE_STAGE), records.COLUMNS)
        self.core.tc_accelerations(*given, byref(steps), *pointers(accelerations, np.empty(size)))
        return np.concatenate([states[half:], accelerations.T])

    def gap(self, state: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gap of each switch, m, and its rate, m/s; see :class:`Equation`."""
        gap, rate, work = np.empty(self.switches), np.empty(self.switches), np.empty(self.work_size)
        self.core.tc_gap(
            self.at, byref(self.drive(u)), *pointers(state, gap, rate, work),
        )  # fmt: skip
        return gap, rate

    def restored(self, state: FloatArray, u: FloatArray) -> FloatArray:
        """Return a state with its bars on their lengths under an input; see :func:`project`."""
        state, work = state.copy(), np.empty(self.work_size)
        drive = self.drive(u)
        self.core.tc_restore(self.at, byref(drive), self.lengths_at, *pointers(state, work))
        return state

    def frequency(
        self, state: FloatArray, u: FloatArray, difference: float, vector: FloatArray
    ) -> float:
        """Return the largest angular frequency of small motions about a state, rad/s.

        By power iteration from a vector on differences of a length, m. Contacts are taken as open.
        """
        work = np.empty(self.work_size)
        return float(
            self.core.tc_frequency(
                self.at, byref(self.drive(u)), *pointers(state),
                ctypes.c_double(difference), *pointers(vector, work),
            )
        )  # fmt: skip

    def kinetic_energy(self, rates: FloatArray) -> FloatArray:
        """Return the kinetic energy, J, shape (T,), of velocities (d, n, T), m/s."""
        count, rates = rates.shape[2], times_in_rows(rates)
        energy = np.empty(count)
        motion = records.Motion.of(rates)
        self.core.tc_kinetic_energy(self.at, count, byref(motion), *pointers(energy))
        return energy

    def potential_energy(
        self, nodes: FloatArray, inputs: FloatArray, load: FloatArray | None
    ) -> FloatArray:
        """Return what strings store, less what a load does, J, shape (T,).

        Of nodes (d, n, T), m, inputs (α, T) and a load (d, n), N.
        """
        count, nodes = nodes.shape[2], times_in_rows(nodes)
        energy, work = np.empty(count), np.empty(2 * count)
        motion = records.Motion.of(nodes)
        inputs, is_constant = _rows_of(inputs)
        self.core.tc_potential_energy(
            self.at, count, byref(motion), *pointers(inputs), is_constant,
            _entries(load), *pointers(energy, work),
        )  # fmt: skip
        return energy

    def conservation(
        self, nodes: FloatArray, rates: FloatArray, inputs: FloatArray, load: FloatArray | None
    ) -> records.Conservation:
        """Return how well a motion keeps its energy and its bars, to the bits of what is above."""
        count, nodes, rates = nodes.shape[2], times_in_rows(nodes), times_in_rows(rates)
        inputs, is_constant = _rows_of(inputs)
        motions = byref(records.Motion.of(nodes)), byref(records.Motion.of(rates))
        conserved, work = records.Conservation(), np.empty(4 * count)
        given, work_at = pointers(inputs, work)
        self.core.tc_conservation(
            self.at, count, *motions, given, is_constant, _entries(load), self._bar_length,
            byref(conserved), work_at,
        )  # fmt: skip
        return conserved

    def strut_work(
        self, states: FloatArray, u: FloatArray, times: FloatArray,
        quadrature: tuple[FloatArray, FloatArray],
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Return force densities of bars that are driven, N/m, and what their drives do, J.

        In states (states, K + 1) at times after that of the input, s, (K + 1), with the shape (β,
        K + 1), and between them, (β, K), by shares and weights of a quadrature over each part. Of
        redundant bars the force densities are not those of least norm.
        """
        states, (shares, weights) = np.ascontiguousarray(states.T), quadrature
        parts, bars, drive = len(times) - 1, self.scene.bars, byref(self.drive(u))
        density, done = np.empty((parts + 1, bars)), np.empty((parts, bars))
        work = np.empty(self.core.tc_strut_work_size(self.at, drive))
        rule = records.Quadrature(len(shares), *map(records.address, (shares, weights)))
        self.core.tc_strut_work(
            self.at, drive, byref(rule), parts,
            *pointers(np.ascontiguousarray(times), states, density, done, work),
        )  # fmt: skip
        return density.T, done.T


class CoreMotion:
    """A motion within a span, advanced by the core in parts.

    Parameters
    ----------
    scene : CoreScene
    state, u : ndarray
        x and the input at the start.
    settings : Settings
    rules : Spans, optional
        Of the steps of DOP853.

    Attributes
    ----------
    state : ndarray, shape (states,)
        Where it has come to.
    done : int
        Outputs that are reached.
    is_over : bool
        Whether the last of them is.
    progress : Progress
    """

    def __init__(
        self, scene: CoreScene, state: FloatArray, u: FloatArray, settings: records.Settings,
        rules: records.Spans | None = None,
    ) -> None:  # fmt: skip
        self._scene, self._u, self._settings = scene, u, settings
        states, room = len(state), settings.room
        self._states = np.empty((states, settings.outputs + 1))
        self._states[:, 0] = state
        # Ends of steps that are kept: of the call at work, and of those before.
        shapes = (room, (room, states), (room, scene.switches)) if room else ()
        self._steps = list(map(np.empty, shapes))
        self._traced: list[list[FloatArray]] = []
        # All parts of steps are to be kept where they are traced.
        self._most_steps = room // _PARTS if settings.traces else _MOST_STEPS
        self.done, self.is_over = 0, False
        self.progress = records.Progress(every=1)
        memory = np.empty(scene.memory_size)
        self.state = memory[:states]
        self.state[:] = state
        first = records.address(memory)
        state_at, taut_at, slope_at, scale_at, work_at = [
            c_void_p(first + place) for place in scene.places
        ]
        given, how = (scene.at, byref(scene.drive(u))), byref(settings)
        if rules is None:
            scene.core.tc_taut(*given, state_at, taut_at, work_at)
        else:
            start = byref(rules), how, state_at, taut_at, slope_at, scale_at, work_at
            scene.core.tc_start(*given, *start)
        self.progress.step, self._progress_at = settings.step, byref(self.progress)
        kept = pointers(*self._steps) if room else (None, None, None)
        self._arguments = (
            *given, scene.lengths_at, how, self._progress_at, state_at, slope_at, taut_at,
            *pointers(self._states), *kept, work_at,
        )  # fmt: skip

    @property
    def whole(self) -> FloatArray:
        """The start and the outputs that are reached, shape (states, done + 1)."""
        return self._states if self.is_over else self._states[:, : self.done + 1]

    @property
    def ends(self) -> tuple[FloatArray, ...]:
        """Times, states and ``taut``, with one column each, of the ends of steps that are kept.

        Where they are not traced times and states; nothing where none are kept. In memory of their
        own: of the room for them most is left as a rule.
        """
        if not self._steps:
            return ()
        if self._settings.traces:
            parts = self._traced or [[array[:0] for array in self._steps]]
            time, *rest = parts[0]
            if len(parts) > 1:
                time, *rest = map(np.concatenate, zip(*parts, strict=True))
        else:
            time, *rest = self._kept(self._steps[:2])
        return time, *(array.T for array in rest)

    def _kept(self, steps: list[FloatArray]) -> list[FloatArray]:
        """Return those of some numbers of ends of steps that the last call kept."""
        return [array[: self.progress.kept].copy() for array in steps]

    @property
    def evaluations(self) -> int:
        """Of the equation, by DOP853."""
        return int(self._scene.core.tc_evaluations(self._progress_at))

    @property
    def is_paused(self) -> bool:
        """Whether the evaluations of the settings are used up."""
        return bool(self.evaluations >= self._settings.limit)

    def advance(self, budget: int) -> bool:
        """Go on by at most so many steps that are tried; return whether it is over."""
        self._settings.budget = min(budget, self._most_steps)
        self.done = self._scene.core.tc_advance(*self._arguments)
        self.is_over = self.done == self._settings.outputs
        if self._settings.traces:
            self._traced.append(self._kept(self._steps))
            self.progress.kept = 0
        return self.is_over


def _rows_of(inputs: FloatArray) -> tuple[FloatArray, bool]:
    """Return inputs (α, T) as the core takes them, and whether they are one column at all times."""
    is_constant = inputs.shape[1] > 0 and inputs.strides[1] == 0
    return np.ascontiguousarray(inputs[:, :1] if is_constant else inputs), is_constant


def _entries(load: FloatArray | None) -> Any:
    """Return a load (d, n) as the core takes it: node by node, null if there is none."""
    return None if load is None else pointers(load.ravel(order="F"))[0]


def times_in_rows(motion: FloatArray) -> FloatArray:
    """Return a motion (d, n, T) whose times are next to one another in memory."""
    return motion if motion.strides[2] == motion.itemsize else np.ascontiguousarray(motion)
