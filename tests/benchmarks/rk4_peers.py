"""The classical RK4 in NumPy and JAX, and methods of Diffrax, for bars that share no nodes.

Of the ways to write the forces those are here that took least time: strings gathered node by node
for one run in JAX, unrolled with the runs along the last axis for many, gathered string by string
in NumPy. JAX is told that the machine has one processor: for arrays so small, threads that wait for
each other took twice the processor time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.sparse import csr_array

import tenscontrol as tc
from tenscontrol.accuracy.peers.peer import spaced
from tests.benchmarks.cheapest import Program

# Accelerations of nodes and velocities: shapes (3, n), or (3, n, runs).
Acceleration = Callable[[Any, Any], Any]

# Steps that JAX does in one turn of its loop: one, two or eight took it longer.
_AT_ONCE = 4


@cache
def one_thread() -> Any:
    """Return JAX, which from here on has double precision and one thread."""
    import jax

    jax.config.update("jax_enable_x64", True)
    if hasattr(os, "sched_setaffinity"):
        allowed = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(allowed)})
        jax.devices()  # counts the processors
        os.sched_setaffinity(0, allowed)
    return jax


def is_missing(package: str) -> bool:
    """Return whether a package is not installed, and say so."""
    if find_spec(package) is not None:
        return False
    print(f"{package} is not installed: pip install '.[bench]'")
    return True


# ---- forces ----


def by_nodes(case: tc.Scene, xp: Any, lengths: Any = None) -> Acceleration:
    """Return accelerations, each string reckoned at both of its nodes; of other rest lengths."""
    structure = case.structure
    near: list[list[tuple[int, int]]] = [[] for _ in range(structure.nodes.shape[1])]
    for string, (one, other) in enumerate(structure.strings.tolist()):
        near[one].append((other, string))
        near[other].append((one, string))
    most = max(map(len, near))
    full = [[*some, *[(node, -1)] * (most - len(some))] for node, some in enumerate(near)]
    partner, string = np.array(full).transpose(2, 1, 0)
    stiffness = np.append(_stiffness(case), 0.0)[string]
    rest = xp.append(case.input_value if lengths is None else lengths, 1.0)[string]
    bars = _bars(case, xp)

    def accelerations(N: Any, V: Any) -> Any:
        S = N[:, partner] - N[:, None]
        length = xp.sqrt(xp.maximum((S * S).sum(axis=0), 1e-24))
        return bars(N, V, (xp.maximum(stiffness * (1 - rest / length), 0.0) * S).sum(axis=1))

    return accelerations


def _bars(case: tc.Scene, xp: Any) -> Callable[[Any, Any, Any], Any]:
    """Return accelerations by nodes, velocities and forces of strings, with load and ground."""
    structure = case.structure
    end, mass = (np.empty(structure.nodes.shape[1], kind) for kind in (int, float))
    for (i, j), m in zip(structure.bars, structure.bar_mass, strict=True):
        end[[i, j]], mass[[i, j]] = (j, i), m
    inverse, load, ground = 1 / mass, case.load, _ground(case, xp)

    def accelerations(N: Any, V: Any, F: Any) -> Any:
        F = F + load + ground(N, V)
        b, rate, across = (x - x[:, end] for x in (N, V, F))
        across = 6 * inverse * across
        pull = (rate * rate + b * across).sum(axis=0) / (b * b).sum(axis=0)
        return (F + F[:, end]) * inverse + (across - pull * b) / 2

    return accelerations


def unrolled(case: tc.Scene, xp: Any, kind: Any = np.float64) -> Acceleration:
    """Return accelerations of many runs, (3, n, runs), written out string by string."""
    structure = case.structure
    n = structure.nodes.shape[1]
    number = np.dtype(kind).type
    constants = (_stiffness(case), _stiffness(case) * case.input_value, structure.bar_mass)
    stiffness, at_rest, mass = (values.astype(kind) for values in constants)
    load, ground = case.load.astype(kind), _ground(case, xp, number)

    def accelerations(N: Any, V: Any) -> Any:
        F = [load[:, node, None] for node in range(n)]
        for (i, j), k, kr in zip(structure.strings.tolist(), stiffness, at_rest, strict=True):
            S = N[:, j] - N[:, i]
            pull = xp.maximum(k - kr / xp.sqrt((S * S).sum(axis=0)), number(0)) * S
            F[i], F[j] = F[i] + pull, F[j] - pull
        if case.model.contacts is not None:
            F = [force + ground(N[:, node], V[:, node]) for node, force in enumerate(F)]
        A = [F[0]] * n
        for (i, j), m in zip(structure.bars.tolist(), mass, strict=True):
            b, rate, f = (x[j] - x[i] for x in (N.swapaxes(0, 1), V.swapaxes(0, 1), F))
            inertia = (m / number(12)) * (rate * rate).sum(axis=0)
            pull = -(inertia + (b * f).sum(axis=0) / number(2)) / (b * b).sum(axis=0)
            half, centre = number(3) / m * f + number(6) / m * pull * b, (F[i] + F[j]) / m
            A[i], A[j] = centre - half, centre + half
        return xp.stack(A, axis=1)

    return accelerations


def by_strings(case: tc.Scene) -> Acceleration:
    """Return accelerations in NumPy, (3, n), each string reckoned once, its ends taken by index."""
    structure = case.structure
    (i, j), (start, end) = structure.strings.T, structure.bars.T
    count, n = len(i), structure.nodes.shape[1]
    ends = np.concatenate([i, j]), np.tile(np.arange(count), 2)
    sums = csr_array((np.repeat([1.0, -1.0], count), ends), shape=(n, count))
    stiffness, rest, mass = _stiffness(case), case.input_value, structure.bar_mass
    load, ground = case.load, _ground(case, np)

    def accelerations(N: np.ndarray, V: np.ndarray) -> np.ndarray:
        S = np.take(N, j, 1) - np.take(N, i, 1)
        S *= np.maximum(stiffness * (1 - rest / np.sqrt(np.einsum("ds,ds->s", S, S))), 0.0)
        F = np.stack([sums @ row for row in S]) + load + ground(N, V)
        b, rate, f = (np.take(x, end, 1) - np.take(x, start, 1) for x in (N, V, F))
        inertia = mass / 12 * np.einsum("db,db->b", rate, rate)
        pull = -(inertia + np.einsum("db,db->b", b, f) / 2) / np.einsum("db,db->b", b, b)
        half, centre = 3 / mass * f + 6 / mass * pull * b, (F[:, start] + F[:, end]) / mass
        A = np.empty_like(N)
        A[:, start], A[:, end] = centre - half, centre + half
        return A

    return accelerations


def _stiffness(case: tc.Scene) -> np.ndarray:
    return np.broadcast_to(case.model.strings.stiffness, len(case.structure.strings)).copy()


def _ground(case: tc.Scene, xp: Any, number: Any = float) -> Callable[[Any, Any], Any]:
    """Return the forces of level ground on nodes, (3, ...), 0 where there is none."""
    if case.model.contacts is None:
        return lambda N, V: number(0)
    (law,) = case.model.contacts.laws
    k, damping, friction, slow, height = (
        number(x) for x in (law.stiffness, law.damping, law.friction, law.slip_speed, law.height)
    )

    def forces(N: Any, V: Any) -> Any:
        pressing = xp.maximum(number(1) - damping * V[2], number(0))
        normal = k * xp.maximum(height - N[2], number(0)) * pressing
        slip = -friction * normal / xp.sqrt(V[0] * V[0] + V[1] * V[1] + slow * slow)
        return xp.stack([slip * V[0], slip * V[1], normal])

    return forces


# ---- steps ----


def rk4_step(slope: Acceleration, N: Any, V: Any, h: Any) -> tuple[Any, Any]:
    """Return nodes and velocities after a step."""
    a1 = slope(N, V)
    v2 = V + h / 2 * a1
    a2 = slope(N + h / 2 * V, v2)
    v3 = V + h / 2 * a2
    a3 = slope(N + h / 2 * v2, v3)
    v4 = V + h * a3
    a4 = slope(N + h * v3, v4)
    return N + h / 6 * (V + 2 * v2 + 2 * v3 + v4), V + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def jax_steps(slope: Acceleration, state: Any, h: Any, count: Any) -> Any:
    """Return nodes and velocities after so many steps, several in a turn of the loop."""
    jax = one_thread()

    def several(_: Any, now: Any) -> Any:
        for _ in range(_AT_ONCE):
            now = rk4_step(slope, *now, h)
        return now

    state = jax.lax.fori_loop(0, count // _AT_ONCE, several, state)
    return jax.lax.fori_loop(
        0, count % _AT_ONCE, lambda _, now: rk4_step(slope, *now, h), state
    )  # fmt: skip


# ---- programs for one run ----


def start(case: tc.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and velocities, (3, n)."""
    return np.array(case.nodes), np.array(case.velocities)


def numpy_rk4(case: tc.Scene, times: np.ndarray, steps: Sequence[float]) -> Program:
    """Return RK4 in NumPy, whose steps are naive: no switch is located."""
    slope = by_strings(case)

    def prepare(step: float) -> Callable[[], np.ndarray]:
        spacing, inner = spaced(times, step)

        def run() -> np.ndarray:
            N, V = start(case)
            outputs = []
            with np.errstate(all="ignore"):  # a step may be too long
                for _ in times:
                    for _ in range(inner):
                        N, V = rk4_step(slope, N, V, spacing / inner)
                    outputs.append(N)
            return np.stack(outputs, axis=-1)

        return run

    return Program("NumPy RK4", steps, prepare)


def jax_rk4(case: tc.Scene, times: np.ndarray, steps: Sequence[float]) -> Program:
    """Return RK4 in a scan over outputs; in single precision it takes as long."""
    jax = one_thread()
    slope = by_nodes(case, jax.numpy)

    @jax.jit
    def solved(N: Any, V: Any, h: Any, inner: Any) -> Any:
        def output(state: Any, _: Any) -> Any:
            state = jax_steps(slope, state, h, inner)
            return state, state[0]

        return jax.lax.scan(output, (N, V), None, length=len(times))[1]

    at_start = tuple(map(jax.numpy.asarray, start(case)))

    def prepare(step: float) -> Callable[[], Any]:
        spacing, inner = spaced(times, step)
        return lambda: jax.block_until_ready(solved(*at_start, spacing / inner, inner))

    return Program("JAX RK4", steps, prepare, _last_axis)


def diffrax(method: str, case: tc.Scene, times: np.ndarray, settings: Sequence[float]) -> Program:
    """Return a method of Diffrax with error control; its state is one array, which is faster."""
    jax = one_thread()
    import diffrax

    slope, outputs = by_nodes(case, jax.numpy), jax.numpy.asarray(times)
    at_start = jax.numpy.stack(start(case))
    equation = diffrax.ODETerm(lambda t, y, args: jax.numpy.stack([y[1], slope(*y)]))

    @jax.jit
    def solved(tolerance: Any, y: Any) -> Any:
        solution = diffrax.diffeqsolve(
            equation, getattr(diffrax, method)(), 0.0, float(times[-1]), None, y,
            saveat=diffrax.SaveAt(ts=outputs), max_steps=200_000, throw=False,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        )  # fmt: skip
        return solution.ys[:, 0]  # not finite where no steps are left

    def prepare(tolerance: float) -> Callable[[], Any]:
        return lambda: jax.block_until_ready(solved(tolerance, at_start))

    return Program(f"Diffrax {method}", settings, prepare, _last_axis)


def _last_axis(outputs: Any) -> np.ndarray:
    return np.moveaxis(np.asarray(outputs), 0, -1)


# ---- programs for many runs ----


def jax_many(
    case: tc.Scene, velocities: np.ndarray, kind: Any, block: int, steps: Sequence[float]
) -> Program:
    """Return RK4 of many runs, velocities (runs, 3, n), in equal blocks one after the other."""
    jax = one_thread()
    runs, slope = len(velocities), unrolled(case, jax.numpy, kind)
    blocks = np.moveaxis(velocities.reshape(runs // block, block, 3, -1), 1, -1).astype(kind)
    nodes = np.repeat(case.nodes[:, :, None], block, axis=2).astype(kind)

    @jax.jit
    def solved(blocks: Any, h: Any, count: Any) -> Any:
        return jax.lax.map(lambda V: jax_steps(slope, (nodes, V), h, count)[0], blocks)

    at_start = jax.numpy.asarray(blocks)

    def prepare(step: float) -> Callable[[], Any]:
        count = max(1, round(case.duration / step))
        h = np.dtype(kind).type(case.duration / count)
        return lambda: jax.block_until_ready(solved(at_start, h, count))

    def back(ends: Any) -> np.ndarray:
        return np.moveaxis(np.asarray(ends, float), -1, 1).reshape(velocities.shape)

    return Program(f"JAX RK4, {np.dtype(kind).name}, blocks of {block}", steps, prepare, back)


def numpy_many(
    case: tc.Scene, velocities: np.ndarray, block: int, steps: Sequence[float]
) -> Program:
    """Return RK4 of many runs in NumPy, in blocks that stay in the cache."""
    slope = unrolled(case, np)

    def prepare(step: float) -> Callable[[], np.ndarray]:
        count = max(1, round(case.duration / step))

        def run() -> np.ndarray:
            ends = np.empty_like(velocities)
            with np.errstate(all="ignore"):
                for first in range(0, len(velocities), block):
                    V = np.ascontiguousarray(np.moveaxis(velocities[first : first + block], 0, -1))
                    N = np.repeat(case.nodes[:, :, None], V.shape[2], axis=2)
                    for _ in range(count):
                        N, V = rk4_step(slope, N, V, case.duration / count)
                    ends[first : first + block] = np.moveaxis(N, -1, 0)
            return ends

        return run

    return Program(f"NumPy RK4, blocks of {block}", steps, prepare)
