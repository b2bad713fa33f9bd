"""JAX and Diffrax on the ball of ``thrown_ball``: vectorized, double precision, compiled once."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tenscontrol.accuracy.peers import Peer, Solution
from tenscontrol.accuracy.peers.peer import spaced
from tenscontrol.simulation import Scene


def acceleration(case: Scene) -> Callable[[Any, Any], Any]:
    """Return ``(N, V) -> A`` of class-1 bars alone, (n, 3) each, by strings gathered node by node.

    Of four ways to write it (gathered by strings with scattered sums, by dense incidence matrices,
    by nodes, coordinates first), this took JAX least time.
    """
    import jax.numpy as jnp

    structure, law = case.structure, case.model.strings
    n = structure.nodes.shape[1]
    near: list[list[tuple[int, int]]] = [[] for _ in range(n)]
    for string, (one, other) in enumerate(structure.strings):
        near[one].append((other, string))
        near[other].append((one, string))
    most = max(map(len, near))
    full = [[*each, *[(node, -1)] * (most - len(each))] for node, each in enumerate(near)]
    other, string = np.array(full).transpose(2, 0, 1)
    stiffness = np.append(np.broadcast_to(law.stiffness, len(structure.strings)), 0.0)[string]
    rest = np.append(case.input_value, 1.0)[string]
    partner, mass = np.empty(n, int), np.empty(n)
    for (one, end), m in zip(structure.bars, structure.bar_mass, strict=True):
        partner[[one, end]], mass[[one, end]] = (end, one), m
    load = jnp.array(case.load.T)
    inverse = jnp.array(1 / mass)[:, None]

    def accelerations(N: Any, V: Any) -> Any:
        S = N[other] - N[:, None, :]
        length = jnp.sqrt(jnp.maximum(jnp.sum(S * S, axis=2), 1e-24))
        gamma = jnp.maximum(stiffness * (length - rest), 0.0) / length
        F = load + jnp.sum(S * gamma[..., None], axis=1)
        b, rate, across = (each - each[partner] for each in (N, V, F))
        across = 6 * inverse * across
        square = jnp.sum(b * b, axis=1, keepdims=True)
        pull = jnp.sum(rate * rate + b * across, axis=1, keepdims=True) / square
        return (F + F[partner]) * inverse + (across - pull * b) / 2

    return accelerations


def rk4_step(accelerations: Callable[..., Any], N: Any, V: Any, h: float) -> tuple[Any, Any]:
    """Return nodes and velocities after a step."""
    a1 = accelerations(N, V)
    v2 = V + h / 2 * a1
    a2 = accelerations(N + h / 2 * V, v2)
    v3 = V + h / 2 * a2
    a3 = accelerations(N + h / 2 * v2, v3)
    v4 = V + h * a3
    a4 = accelerations(N + h * v3, v4)
    return N + h / 6 * (V + 2 * v2 + 2 * v3 + v4), V + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def _starts(case: Scene) -> tuple[Any, Any]:
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    return jnp.array(case.nodes.T), jnp.array(case.velocities.T)


def _solution(nodes: Any, velocities: Any) -> Solution:
    parts = (np.asarray(part).transpose(2, 1, 0) for part in (nodes, velocities))
    return Solution(*parts, evaluations=0)


class JaxRK4(Peer):
    """The classical method of order 4 in a scan over outputs; settings are steps, s."""

    name = "jax rk4"

    def __init__(self, settings: Sequence[float]) -> None:
        self.settings = tuple(settings)
        self._compiled: Any = None

    def prepare(self, case: Scene, setting: float, times: Any) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        N, V = _starts(case)
        import jax

        spacing, inner = spaced(times, setting)
        slope = acceleration(case)

        def solved(N: Any, V: Any, inner: Any, h: Any) -> Any:
            def output(state: Any, _: Any) -> Any:
                state = jax.lax.fori_loop(0, inner, lambda _, now: rk4_step(slope, *now, h), state)
                return state, state

            return jax.lax.scan(output, (N, V), None, length=len(times))[1]

        if self._compiled is None:  # the number of steps is an input
            self._compiled = jax.jit(solved)
        return lambda: _solution(
            *jax.block_until_ready(self._compiled(N, V, inner, spacing / inner))
        )


class Diffrax(Peer):
    """A method of Diffrax with error control; settings are tolerances, relative and absolute."""

    def __init__(self, method: str, settings: Sequence[float]) -> None:
        self.name, self._method = f"diffrax {method.lower()}", method
        self.settings = tuple(settings)
        self._compiled: Any = None

    def prepare(self, case: Scene, setting: float, times: Any) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        N, V = _starts(case)
        import diffrax
        import jax
        import jax.numpy as jnp

        slope = acceleration(case)
        outputs, end = jnp.array(times), float(times[-1])

        def solved(tolerance: Any, N: Any, V: Any) -> Any:
            found = diffrax.diffeqsolve(
                diffrax.ODETerm(lambda t, y, args: (y[1], slope(*y))),
                getattr(diffrax, self._method)(), 0.0, end, None, (N, V),
                saveat=diffrax.SaveAt(ts=outputs), max_steps=200_000, throw=False,
                stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            )  # fmt: skip
            return *found.ys, found.result == diffrax.RESULTS.successful

        if self._compiled is None:  # the tolerance is an input
            self._compiled = jax.jit(solved)

        def run() -> Solution:
            nodes, velocities, good = jax.block_until_ready(self._compiled(setting, N, V))
            if not good:
                raise ArithmeticError("no steps are left")
            return _solution(nodes, velocities)

        return run
