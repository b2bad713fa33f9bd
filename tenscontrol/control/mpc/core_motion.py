"""The motion of a plant in reduced coordinates, with derivatives, by the compiled core."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref, c_double
from typing import Any, final

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.mpc.problem import Pair, RowBlock, StageJacobians, Triple
from tenscontrol.core import records
from tenscontrol.integrate.core_scene import core_scene
from tenscontrol.plant.linear_plant import LinearPlant, kept
from tenscontrol.plant.reduced_dynamics import refuse_lost_place
from tenscontrol.plant.string_outputs import input_matrix, is_of_strings, model_input

_NOTHING = ctypes.c_void_p(), ctypes.c_void_p()


def core_motion(plant: LinearPlant, *, taut: bool) -> CoreMotion | None:
    """Return the motion of a plant in the core; None where there is none.

    The core has what :func:`core_scene` says, where bars share no nodes.
    """
    return CoreMotion(plant, taut) if _is_known(plant) else None


def core_rows(plant: LinearPlant, blocks: Sequence[RowBlock], at_end: bool) -> CoreRows | None:
    """Return rows that are limited, by the core; None where that has not the motion either."""
    return CoreRows(plant, blocks, at_end) if _is_known(plant) else None


def _is_known(plant: LinearPlant) -> bool:
    equation = plant.model.equation(plant.input)
    return not plant.model.structure.blocks and core_scene(equation) is not None


@final
class CoreMotion:
    """The motion of a plant that :func:`core_motion` takes.

    Parameters
    ----------
    plant : LinearPlant
    taut : bool
        Whether strings push where they would be slack, as for :func:`reduced_acceleration`.
    """

    back_end = "core"

    def __init__(self, plant: LinearPlant, taut: bool) -> None:
        self._made_of = plant, taut
        self._r = plant.degrees_of_freedom
        self._reduced, self._core, self._tables = _tables(plant, taut)
        self._work = np.empty(self._core.tc_reduced_work_size(byref(self._reduced), 0))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of, not its places in memory."""
        return CoreMotion, self._made_of

    def values(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Return q̈, (K, r), and what :meth:`slopes` takes."""
        given = [np.ascontiguousarray(array) for array in (states, inputs)]
        return self._found(given, self._r), given

    def slopes(self, given: list[FloatArray], points: IntArray) -> Pair:
        """Return slopes of q̈ at k of the points, by columns: by z, (k, 2r, r), and u, (k, α, r)."""
        chosen = [array[points] for array in given]
        by_z, by_u = (np.empty((*array.shape, self._r)) for array in chosen)
        self._found(chosen, self._r, (by_z, by_u))
        return by_z, by_u

    def __call__(self, states: FloatArray, inputs: FloatArray) -> Triple:
        """Return q̈ and its slopes at all points."""
        values, given = self.values(states, inputs)
        return values, *self.slopes(given, np.arange(len(states)))

    def samples(
        self, states: FloatArray, inputs: FloatArray, steps: int, length: float,
        slopes: Pair | None = None,
    ) -> FloatArray:  # fmt: skip
        """Return states, (K, 2r), after steps of RK4 of a length, s, with held inputs.

        Slopes become those of the ends, by columns: by z, (K, 2r, 2r), and by u, (K, α, 2r).
        """
        given = [np.ascontiguousarray(array) for array in (states, inputs)]
        return self._found(given, 2 * self._r, slopes, steps, length)

    def _found(
        self, given: list[FloatArray], size: int, slopes: Pair | None = None, steps: int = 0,
        length: float = 0.0,
    ) -> FloatArray:  # fmt: skip
        values = np.empty((len(given[0]), size))
        self._core.tc_reduced_motion(
            byref(self._reduced), len(values), steps, c_double(length),
            *records.pointers(*given, values),
            *(_NOTHING if slopes is None else records.pointers(*slopes)),
            *records.pointers(self._work),
        )  # fmt: skip
        return values


@final
class CoreRows:
    """Rows that are limited, of strings first, then of nodes, and their derivatives along a plan.

    Parameters
    ----------
    plant : LinearPlant
    blocks : sequence of RowBlock
    at_end : bool
        Whether strings are limited at the ends of samples.
    """

    def __init__(self, plant: LinearPlant, blocks: Sequence[RowBlock], at_end: bool) -> None:
        self._made_of = plant, blocks, at_end
        quantities = [block.quantity for block in blocks]
        first = np.cumsum([0, *(len(block.low) for block in blocks)]).tolist()
        self._count, strings = first[-1], sum(map(bool, quantities))
        self._on_nodes = np.concatenate(
            [np.zeros((0, plant.nodes.size)), *(block.on_nodes for block in blocks[strings:])]
        )
        density, tension = (
            first[quantities.index(name)] if name in quantities else -1
            for name in ("force_density", "tension")
        )
        self._record = records.Rows(
            self._count, density, tension, first[strings], at_end, len(self._on_nodes),
            self._on_nodes.ctypes.data,
        )  # fmt: skip
        self._reduced, self._core, self._tables = _tables(plant, taut=True)
        self._work = np.empty(self._core.tc_reduced_work_size(byref(self._reduced), self._count))
        self._slopes: tuple[FloatArray, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of, not its places in memory."""
        return CoreRows, self._made_of

    @property
    def patterns(self) -> tuple[FloatArray, ...]:
        """Ones where a derivative by z, u and z⁺ can be other than zero, shape (p, ·) each."""
        plant, blocks, at_end = self._made_of
        structure, (s, a) = plant.model.structure, plant.B.shape
        moved = np.abs(plant.basis) > 0
        places = np.arange(plant.nodes.size).reshape(-1, structure.dimension)
        for ends in structure.bars:  # a bar on its length moves with both
            moved[places[ends].ravel()] |= moved[places[ends].ravel()].any(axis=0)
        by_strings = np.zeros((len(structure.strings), s), bool)
        for string, ends in zip(structure.segment_string, structure.segments, strict=True):
            by_strings[string, : s // 2] |= moved[places[ends].ravel()].any(axis=0)
        law = plant.model.strings
        if plant.input == "rest_length" and law is not None and law.is_damped:
            by_strings[:, s // 2 :] = by_strings[:, : s // 2]
        by_nodes = (np.abs(self._on_nodes) > 0) @ moved
        of_strings = sum(bool(block.quantity) for block in blocks)
        strings = np.tile(by_strings, (of_strings, 1))
        none = np.zeros_like(strings)
        nodes = np.hstack([by_nodes, np.zeros_like(by_nodes)])
        by_input = np.tile(np.abs(input_matrix(plant, plant.string_input)) > 0, (of_strings, 1))
        whole = (
            np.vstack([none if at_end else strings, np.zeros_like(nodes)]),
            np.vstack([by_input, np.zeros((len(nodes), a), bool)]),
            np.vstack([strings if at_end else none, nodes]),
        )
        return tuple(pattern.astype(float) for pattern in whole)

    def __call__(self, states: FloatArray, inputs: FloatArray, later: FloatArray) -> StageJacobians:
        """Return rows to first order in z_k, u_k and z_{k+1}."""
        N, p = len(states), self._count
        if not self._slopes:  # what is never other than zero stays so
            widths = states.shape[1], inputs.shape[1], later.shape[1]
            self._slopes = tuple(np.zeros((N, k, p)) for k in widths)
        values = np.empty((N, p))
        given = [np.ascontiguousarray(array) for array in (states, inputs, later)]
        self._core.tc_reduced_rows(
            byref(self._reduced), byref(self._record), N,
            *records.pointers(*given, values, *self._slopes, self._work),
        )  # fmt: skip
        return StageJacobians(values, self._slopes)


@kept
def _tables(plant: LinearPlant, taut: bool) -> tuple[records.Reduced, ctypes.CDLL, list[Any]]:
    """Return the record of a plant, the core, and what the record points to."""
    refuse_lost_place(plant)
    model, structure, T = plant.model, plant.model.structure, plant.basis
    scene = core_scene(model.equation(plant.input))
    assert scene is not None  # core_motion asks for it
    r, d, m = plant.degrees_of_freedom, structure.dimension, plant.nodes.size
    load = plant.external_force if model.has_external_force else model.constant_force
    bars, axes = plant.coordinates.alone
    free = np.isin(np.arange(m), structure.free_rows)
    project = plant.coordinates.project(np.eye(m)) * free
    # T P, or what it leaves out, which may be of a smaller rank.
    left_out = len(structure.free_rows) - r
    left, right = T, project
    if left_out < r:
        U, sizes, right = np.linalg.svd(np.diag(free * 1.0) - T @ project)
        left, right = U[:, :left_out] * sizes[:left_out], right[:left_out]
    arrays = {
        "place": plant.nodes.ravel(order="F"), "basis": T, "project": project, "left": left,
        "right": right, "axis": axes.T, "share": structure.end_share[bars],
        "square": structure.bar_length[bars] ** 2, "load": load.ravel(order="F"),
    }  # fmt: skip
    if not is_of_strings(plant):
        arrays["spread"] = input_matrix(plant, plant.string_input)
        arrays["offset"] = np.array(model_input(plant, np.zeros(plant.B.shape[1]))).ravel()
    if taut:
        arrays["taut"] = np.ones(len(structure.strings))
        arrays["taut"][plant.slack] = 0.0
    arrays = {name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()}
    arrays["end"] = np.ascontiguousarray(d * structure.bars[bars], np.int32)
    places = {name: records.address(array) for name, array in arrays.items()}
    tables = records.Scene.from_buffer_copy(scene.scene)
    tables.load = places.pop("load")
    record = records.Reduced(
        scene=ctypes.addressof(tables), coordinates=r, inputs=plant.B.shape[1], bars=len(bars),
        inner=left.shape[1], is_complement=left_out < r, **places,
    )  # fmt: skip
    return record, scene.core, [scene, tables, arrays]
