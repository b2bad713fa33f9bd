"""Derivatives of a run by its inputs: error against processor time, beside JAX and differences.

Run: ``python -m tests.benchmarks.derivatives [--cases jacobian] [--scenes taut switching]``.

A six-bar ball is thrown and spins for a second; its strings stay taut, or go slack. ``jacobian``:
the 36 coordinates of its nodes at the end by its 24 rest lengths. ``gradient``: a cost of where
they are by 50 values of each rest length, one a sample of 0.02 s. Ours is the call as it is typed,
the run itself with it; then central differences by ``simulate_many``; then JAX, forward and in
reverse, through the steps of RK4, which passes over switches. All keep the start and the end alone.
An error is the largest of an entry, as part of the largest entry; the true derivative is ours at a
tolerance of 1e-9, tested against differences (``python -m tests.benchmarks.sensitivities``). The
Jacobian by MuJoCo's ``mjd_transitionFD`` stands beside it at steps and errors of its own: it
differences each step of Euler's method, as it refuses RK4, and the matrices are multiplied. Needs
the extra ``bench``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

import tenscontrol as tc
from tests.benchmarks import rk4_peers
from tests.benchmarks.cheapest import Program, grid, reported, seconds_of, tolerances
from tests.benchmarks.command_line import options
from tests.benchmarks.error_against_time import thrown

SAMPLES = 50

# Spin, rad/s, stiffness and prestress, N/m.
SCENES = {"taut": (1.5, 2000.0, 40.0), "switching": (3.0, 500.0, 0.5)}
LIMITS = tc.HealthLimits(crossings=None, position_error=None)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table a case."""
    given = options(
        __doc__, arguments, cases=("jacobian", "gradient"), scenes=tuple(SCENES),
        errors=(1e-3, 1e-5), repeats=7, duration=1.0, longest=2.0,
    )  # fmt: skip
    for name, case in product(given.scenes, given.cases):
        scene = thrown(given.duration, *SCENES[name])
        programs, exact = {"jacobian": jacobian, "gradient": gradient}[case](scene)
        true = exact()

        def judge(values: np.ndarray, true: np.ndarray = true) -> float:
            return float(np.abs(values - true).max() / np.abs(true).max())

        print(f"\n{case}, {name}: {scene.name}, {scene.duration:g} s", flush=True)
        first = reported(programs, judge, given.errors, given.repeats, given.longest)[0]
        if case == "jacobian" and not rk4_peers.is_missing("mujoco"):
            for step in (1e-2, 1e-3):
                run, found = transitions(scene, step), list[np.ndarray]()
                seconds = seconds_of(lambda run=run, found=found: found.append(run()))
                print(
                    f"MuJoCo, transitionFD, {step:g} s: has {judge(found[0]):.1e}, "
                    f"{1e3 * seconds:.4g} ms, {seconds / first.seconds:.3g} over the first"
                )


def run_of(scene: tc.Scene, tolerance: float) -> tc.Trajectory:
    """Return the motion of a scene at its start and end, without limits that warn."""
    how = tc.Integration(
        tolerance=tolerance, error="none", output_step=scene.duration, limits=LIMITS
    )
    return replace(scene, integration=how).simulate()


def jacobian(scene: tc.Scene) -> tuple[list[Program], Callable[[], np.ndarray]]:
    """Return what finds the nodes at the end by the rest lengths, (3, n, α)."""
    lengths = scene.input_value

    def ours(tolerance: float) -> np.ndarray:
        return tc.sensitivity(run_of(scene, tolerance), ["rest_length"]).nodes["rest_length"][
            :, :, 0
        ]

    def differences(tolerance: float) -> np.ndarray:
        change = 2e-3 * tolerance ** (1 / 3)  # 1e-5 m at 1e-7
        steps = change * np.eye(len(lengths))
        how = tc.Integration(tolerance=tolerance, error="none")
        varied = {"rest_length": np.vstack([lengths + steps, lengths - steps])}
        with warnings.catch_warnings(action="ignore"):
            batch = tc.simulate_many(replace(scene, integration=how), varied, threads=1)
        up, down = np.split(batch.nodes[..., -1], 2)
        return np.moveaxis(up - down, 0, 2) / (2 * change)

    programs = [
        timed("tenscontrol, sensitivity", tolerances(1e-2, 1e-9), ours),
        timed("tenscontrol, central differences", tolerances(1e-2, 1e-12), differences),
    ]
    if not rk4_peers.is_missing("jax"):
        jax = rk4_peers.one_thread()
        programs.append(through_jax(scene, "JAX, forward", jax.jacfwd, lengths, lambda N: N))
    return programs, lambda: ours(1e-9)


def gradient(scene: tc.Scene) -> tuple[list[Program], Callable[[], np.ndarray]]:
    """Return what finds a cost of the nodes at the end by the values of a profile, (α, samples)."""
    values = np.tile(scene.input_value[:, None], SAMPLES)
    times = np.arange(SAMPLES) * scene.duration / SAMPLES
    held = replace(scene, rest_length=tc.Profile(times, values, "hold"))

    def ours(tolerance: float) -> np.ndarray:
        run = run_of(held, tolerance)
        cost = tc.gradient(run, lambda _, nodes, __: ca.sumsqr(nodes), ["rest_length"])
        return cost.slope["rest_length"]

    programs = [timed("tenscontrol, gradient", tolerances(1e-2, 1e-9), ours)]
    if not rk4_peers.is_missing("jax"):
        jax = rk4_peers.one_thread()
        programs.append(
            through_jax(scene, "JAX, reverse", jax.grad, values, lambda N: (N * N).sum())
        )
    return programs, lambda: ours(1e-9)


def transitions(scene: tc.Scene, step: float) -> Callable[[], np.ndarray]:
    """Return what finds the nodes at the end by the rest lengths from MuJoCo's differences."""
    import mujoco

    text = tc.exchange.to_mujoco(
        scene.model, nodes=scene.nodes, velocities=scene.velocities, rest_length=scene.input_value,
        actuators="rest_length", step=step, integrator="euler",
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data, (d, n) = mujoco.MjData(model), scene.nodes.shape
    by_state, by_input = np.empty((2 * model.nv, 2 * model.nv)), np.empty((2 * model.nv, model.nu))
    of_site, strings = np.empty((d, model.nv)), len(scene.input_value)

    def run() -> np.ndarray:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        moved = np.zeros((2 * model.nv, model.nu))
        for _ in range(round(scene.duration / step)):
            mujoco.mjd_transitionFD(model, data, 1e-6, False, by_state, by_input, None, None)
            moved = by_state @ moved + by_input
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        nodes = np.empty((d, n, strings))
        for node in range(n):
            mujoco.mj_jacSite(model, data, of_site, None, model.site(f"n{node}").id)
            nodes[:, node] = of_site @ moved[: model.nv, :strings]
        return nodes

    return run


def timed(name: str, settings: Sequence[float], call: Callable[[float], np.ndarray]) -> Program:
    """Return a program that is a call of its setting."""
    return Program(name, settings, lambda setting: lambda: call(setting))


def through_jax(
    scene: tc.Scene, name: str, transform: Any, inputs: np.ndarray, cost: Callable[[Any], Any]
) -> Program:
    """Return a transformation of what JAX's RK4 makes of rest lengths, (α,) or (α, samples)."""
    jax = rk4_peers.one_thread()
    start = scene.nodes, scene.velocities
    samples = 1 if inputs.ndim == 1 else inputs.shape[1]

    def prepare(step: float) -> Callable[[], np.ndarray]:
        count = int(np.ceil(scene.duration / samples / step))
        h = scene.duration / samples / count

        def end(rest: Any) -> Any:
            def sample(state: Any, lengths: Any) -> tuple[Any, None]:
                slope = rk4_peers.by_nodes(scene, jax.numpy, lengths)
                advance = lambda now, _: (rk4_peers.rk4_step(slope, *now, h), None)  # noqa: E731
                return jax.lax.scan(advance, state, None, length=count)[0], None

            stacked = rest[None] if rest.ndim == 1 else rest.T
            return cost(jax.lax.scan(sample, start, stacked)[0][0])

        compiled = jax.jit(transform(end))
        compiled(inputs)
        return lambda: np.asarray(compiled(inputs))

    return Program(name, grid(scene.duration / SAMPLES, 1e-4 * scene.duration, 2.0), prepare)


if __name__ == "__main__":
    main()
