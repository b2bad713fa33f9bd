"""Functions of the model over a motion: energies, momenta, force densities."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from casadi import Function

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.core import records
from tenscontrol.core.library import library
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.core_scene import CoreScene, times_in_rows

# Times at which functions of the model are evaluated in one go: few enough that what they need of a
# large structure stays small.
BLOCK = 128


@dataclass(frozen=True, eq=False)
class MotionFunctions:
    """What energies, momenta and force densities of a motion are evaluated from, when asked for.

    Attributes
    ----------
    model : Model
    moved : bool
        Whether supports move: functions are then those of all nodes.
    inputs : ndarray, shape (α, T)
        Rest lengths or force densities.
    load : ndarray, shape (d, n), or (d n, T) where it changes, node by node; or None
        N.
    stored : ndarray, shape (T,), or None
        What the ground stores, J.
    core : CoreScene, optional
        What evaluates energies where the compiled core has the model.
    shared : callable, optional
        Of a run of a batch: ``name -> function, parameters``, the function of the model and the
        columns of its further inputs.
    """

    model: Model
    moved: bool
    inputs: FloatArray
    load: FloatArray | None = None
    stored: FloatArray | None = None
    core: CoreScene | None = None
    shared: Callable[[str], tuple[Function, list[FloatArray]]] | None = None

    def kinetic_energy(self, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the kinetic energy at all times, J, shape (T,), read-only."""
        if self.core is None:
            energy: FloatArray = self.of("kinetic_energy", nodes, velocities)[0][0]
            return energy
        return read_only(self.core.kinetic_energy(velocities))

    def potential_energy(self, name: str, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return what strings and the ground store, less what loads do, J, shape (T,), read-only.

        ``name`` is that of the function of the model for strings.
        """
        held = self.load if self.load_is_held else None
        if self.core is None:
            energy: FloatArray = self.of(name, nodes, velocities, self.inputs)[0][0]
            if held is not None:
                energy = energy - np.einsum("in,int->t", held, nodes)
        else:
            energy = self.core.potential_energy(nodes, self.inputs, held)
        if self.load is not None and held is None:
            energy = energy - (self.load * by_node(nodes)).sum(axis=0)
        return read_only(energy if self.stored is None else energy + self.stored)

    @property
    def load_is_held(self) -> bool:
        """Whether a load is the same at all times, or there is none."""
        return self.load is None or self.load.shape == self.model.structure.nodes.shape

    def of(
        self, name: str, nodes: FloatArray, velocities: FloatArray, *more: FloatArray
    ) -> list[FloatArray]:
        """Return a function of the model at all times, read-only: one array an output."""
        model, count = self.model, nodes.shape[2]
        every = self.moved or not len(model.structure.fixed_rows)
        rows = slice(None) if every else model.structure.free_rows
        if self.shared is not None:
            function, own = self.shared(name)
            more += tuple(np.broadcast_to(values[:, None], (len(values), count)) for values in own)
        else:
            function = model.of_all_nodes(name) if self.moved else getattr(model, name)

        def within(first: int) -> list[FloatArray]:
            some = slice(first, first + BLOCK)
            moving = [by_node(array[:, :, some])[rows] for array in (nodes, velocities)]
            return evaluate_columns(
                function, np.vstack(moving), *(values[:, some] for values in more)
            )

        parts = zip(*(within(first) for first in range(0, count, BLOCK)), strict=True)
        return [read_only(np.hstack(blocks)) for blocks in parts]


def distances(nodes: FloatArray, pairs: IntArray) -> FloatArray:
    """Return the distances of pairs of nodes (d, n, T), m, shape (pairs, T)."""
    core, count = library(), nodes.shape[2]
    length = np.empty((len(pairs), count))
    if core is None:
        start, end = pairs.T
        for first in range(0, count, BLOCK):
            some = slice(first, first + BLOCK)
            apart = nodes[:, end, some] - nodes[:, start, some]
            length[:, some] = np.sqrt(np.einsum("imt,imt->mt", apart, apart))
        return length
    nodes, pairs = times_in_rows(nodes), np.ascontiguousarray(pairs, dtype=np.int32)
    core.tc_distances(
        ctypes.byref(records.Motion.of(nodes)), len(nodes), count, len(pairs),
        *records.pointers(pairs, length),
    )  # fmt: skip
    return length


def by_node(part: FloatArray) -> FloatArray:
    """Return shape (d n, T), node by node, of (d, n, T)."""
    return part.swapaxes(0, 1).reshape(-1, part.shape[2])


def read_only(array: FloatArray) -> FloatArray:
    """Return an array that is not to be written to."""
    array.setflags(write=False)
    return array
