"""The dense oracle's motion in C: :class:`tests.oracle.NodeMotion` at a hundredth of its time.

Lagrange multipliers over the node coordinates and steps of order 8 that end at each switch, as
there; what differs is the language, and that the tolerance is a part of the size of the structure
and of the largest speed. Needs a C compiler. Of the package only the :class:`Structure` is used.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.integrate._ivp import dop853_coefficients as order8

from tests.oracle import (
    HeldForceDensity,
    HeldRestLength,
    NodeMotion,
    Plane,
    consistent_mass,
    free_rows,
    independent_bars,
    segment_pairs,
)

_STATUS = ("done", "too many evaluations", "step too small", "not finite", "stuck at a switch")


class OracleError(RuntimeError):
    """A motion that could not be had."""


@dataclass(frozen=True)
class Work:
    """What a motion took, and times of its first 10,000 switches, s."""

    evaluations: int
    steps: int
    rejections: int
    switches: int
    moments: np.ndarray = field(repr=False)


class _Plane(ctypes.Structure):
    _fields_ = [
        *[(name, ctypes.c_double) for name in (
            "stiffness", "damping", "friction", "slip_speed", "height", "exponent",
        )],
        ("normal", ctypes.c_double * 3),
    ]  # fmt: skip


class _Scene(ctypes.Structure):
    _fields_ = [
        *[(name, ctypes.c_int) for name in (
            "dimension", "nodes", "rows", "bars", "strings", "planes", "outputs",
            "held_force_density",
        )],
        *[(name, ctypes.c_void_p) for name in (
            "row", "bar", "first", "segment", "touches", "inverse", "load", "held", "stiffness",
            "damping", "plane", "a", "b", "c", "e3", "e5", "d", "times",
        )],
        ("size", ctypes.c_double), ("tolerance", ctypes.c_double),
        ("most_evaluations", ctypes.c_long), ("moments", ctypes.c_void_p),
        ("most_moments", ctypes.c_long),
    ]  # fmt: skip


class _Counts(ctypes.Structure):
    _fields_ = [(name, ctypes.c_long) for name in (
        "evaluations", "steps", "rejections", "switches",
    )]  # fmt: skip


def c_compiler() -> str | None:
    """Return the path of a C compiler, or None."""
    names = (os.environ.get("CC"), "cc", "gcc", "clang")
    return next((path for name in names if name and (path := shutil.which(name))), None)


@cache
def _library() -> ctypes.CDLL:
    found, source = c_compiler(), Path(__file__).with_suffix(".c")
    if found is None:
        raise OracleError("there is no C compiler: none of $CC, cc, gcc and clang is on the path")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "located_motion.so"
        command = [found, "-O2", "-std=c99", "-fPIC", "-shared", source, "-o", library, "-lm"]
        subprocess.run(command, check=True)
        return ctypes.CDLL(str(library))


def located_motion(
    structure,
    law: HeldForceDensity | HeldRestLength,
    velocities: np.ndarray,
    times: np.ndarray,
    external_force: np.ndarray | float = 0.0,
    ground: Sequence[tuple[Plane, np.ndarray]] = (),
    tolerance: float = 1e-12,
    most_evaluations: int = 10_000_000,
    nodes: np.ndarray | None = None,
) -> tuple[np.ndarray, Work]:
    """Return node positions at the times (ascending, from 0), shape (d, n, T), and the work.

    Each plane comes with the nodes that it acts on. ``nodes`` are those at the start, where they
    are not those of the structure.

    Raises
    ------
    OracleError
        If the motion takes more evaluations, leaves the range of numbers, or stalls.
    """
    d, count = structure.nodes.shape
    alpha, rows = len(structure.strings), free_rows(structure)
    mass = np.kron(consistent_mass(structure), np.eye(d))[np.ix_(rows, rows)]
    first, pairs = segment_pairs(structure)
    is_held = isinstance(law, HeldForceDensity)
    each = np.zeros(alpha)
    touches = np.zeros((len(ground), count), np.int32)
    for mask, (_, below) in zip(touches, ground, strict=True):
        mask[below] = 1
    planes = (_Plane * max(len(ground), 1))(*[
        _Plane(p.stiffness, p.damping, p.friction, p.slip_speed, p.height, p.exponent,
               (ctypes.c_double * 3)(*p.normal))
        for p, _ in ground
    ])  # fmt: skip
    indices = {
        "row": rows, "bar": structure.bars[independent_bars(structure)], "first": first,
        "segment": pairs, "touches": touches,
    }  # fmt: skip
    numbers = {
        "inverse": np.linalg.inv(mass), "load": np.zeros((count, d)) + np.transpose(external_force),
        "held": law.force_density if is_held else law.rest_length,
        "stiffness": each if is_held else law.stiffness + each,
        "damping": each if is_held else law.damping + each,
        "a": order8.A, "b": order8.B, "c": order8.C, "e3": order8.E3, "e5": order8.E5,
        "d": order8.D, "times": times,
    }  # fmt: skip
    kept = {name: np.ascontiguousarray(value, np.int32) for name, value in indices.items()}
    kept |= {name: np.ascontiguousarray(value, float) for name, value in numbers.items()}
    moments = np.zeros(10_000)
    scene = _Scene(
        dimension=d, nodes=count, rows=len(rows), bars=len(kept["bar"]), strings=alpha,
        planes=len(ground), outputs=len(times), held_force_density=is_held,
        plane=ctypes.cast(planes, ctypes.c_void_p), size=np.ptp(structure.nodes, axis=1).max(),
        tolerance=tolerance, most_evaluations=most_evaluations, moments=moments.ctypes.data,
        most_moments=len(moments), **{name: value.ctypes.data for name, value in kept.items()},
    )  # fmt: skip
    start = structure.nodes if nodes is None else nodes
    N, V = (np.array(part.T, order="C", dtype=float) for part in (start, velocities))
    out, counts = np.zeros((len(times), count, d)), _Counts()
    pointers = [ctypes.c_void_p(part.ctypes.data) for part in (N, V, out)]
    status = _library().located_motion(ctypes.byref(scene), *pointers, ctypes.byref(counts))
    numbers = (getattr(counts, name) for name, _ in _Counts._fields_)
    work = Work(*numbers, moments[: counts.switches])
    if status:
        raise OracleError(f"{_STATUS[status]} after {work}")
    return out.transpose(2, 1, 0), work


def exact_motion(
    structure, law, times, velocities=None, nodes=None, external_force=None, ground=()
) -> tuple[np.ndarray, np.ndarray]:
    """Return node positions at the times, shape (d, n, T), and times of switches.

    By the oracle in C with a tolerance near round-off; by that in NumPy where there is no compiler.
    Planes are under all nodes.
    """
    nodes = structure.nodes if nodes is None else nodes
    velocities = np.zeros_like(nodes) if velocities is None else velocities
    load = 0.0 if external_force is None else external_force
    if c_compiler() is None:
        motion = NodeMotion(structure, law, load, ground)
        return motion.integrate(nodes, velocities, times)
    planes = [(plane, np.arange(nodes.shape[1])) for plane in ground]
    found, work = located_motion(
        structure, law, velocities, times, load, planes, 1e-13, nodes=nodes
    )
    # Strings that switch together by symmetry are landed on one after the other.
    return found, work.moments[np.diff(work.moments, prepend=-1.0) > 1e-10]
