"""A thousand prisms for a second: simulated seconds a processor second, beside peers.

Run: ``python -m tests.benchmarks.batch``. All start in one shape with velocities of their own, with
strings that stay taut, and with strings that go slack. Each method takes the largest of its steps
at which 99 % of the runs end within 1e-3 m of a motion at a tolerance of 1e-10. Times are processor
times of all threads, of calls that are not the first, in alternating repeats; what compiles has
compiled. JAX's ``vmap`` and NumPy run the classical RK4 in double precision on all runs at once,
MuJoCo its ``rollout``; those that are installed take part (extra ``bench``).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers.rigid_bodies import NodeReader
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate import Projector
from tests.benchmarks.command_line import options
from tests.benchmarks.jax_peers import rk4_step

STIFFNESS, SPEED, WITHIN, PART = 100.0, 0.5, 1e-3, 0.99
STEPS = (0.1, 0.0625, 0.05, 0.025, 0.0125, 0.01, 0.005, 0.0025, 0.001)

# A batch by a step, s: positions at the end, shape (runs, 3, 6).
Batch = Callable[[float], np.ndarray]


def thrown(prism: tc.Structure, runs: int) -> np.ndarray:
    """Velocities that bars can have, shape (runs, 3, 6), m/s."""
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    states = np.tile(state[:, None], runs)
    states[18:] = SPEED * np.random.default_rng(0).standard_normal((18, runs))
    exact = Projector(tc.Model(prism).equation("force_density"), True)(states)
    return np.moveaxis(unpack_states(prism, exact)[1], 2, 0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    given = options(
        __doc__, arguments, runs=1000, duration=1.0, repeats=5,
        scenes=("taut", "slack", "controlled"),
    )  # fmt: skip
    prism = tc.prism()
    V = thrown(prism, given.runs)
    if "controlled" in given.scenes:
        controlled(prism, given.runs, given.duration)
    for name in (each for each in given.scenes if each != "controlled"):
        vertical = {"taut": np.sqrt(3) * 17.3205, "slack": 9.0}[name]
        model = tc.Model(prism, strings=tc.LinearStrings(STIFFNESS))
        gamma = np.repeat([17.3205, 17.3205, vertical], 3)
        lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
        case = model, given.duration, V, lengths
        truth = tc.simulate_many(
            model, given.duration, None, V, rest_length=lengths, method="dop853", tolerance=1e-10
        )
        batches = {f"tenscontrol {method}": ours(method, *case) for method in _OURS}
        batches |= {"NumPy RK4": numpy_rk4(*case)} | jax_rk4(*case) | mujoco_rollout(*case)
        switched = truth.switches.sum() / given.runs
        print(f"{name}: {given.runs} prisms, {given.duration:g} s, {switched:.1f} switches a run")
        print("method                     step s  error of 99 %  simulated s / s  first / method")
        table(batches, truth.nodes[..., -1], given.runs * given.duration, given.repeats)


def controlled(prism: tc.Structure, runs: int, duration: float) -> None:
    """Print what loops closed by an MPC take, at once and one by one."""
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=60.0)
    with TemporaryDirectory() as folder:
        code = tc.generate_c(mpc, Path(folder) / "mpc").compile()
    offsets = np.random.default_rng(0).normal(size=(runs, 9))
    starts = np.array([plant.to_nodes(0.02 * q) for q in offsets])
    how = {"method": "rk4", "step": 5e-3}

    def at_once() -> np.ndarray:
        batch = tc.simulate_many(
            plant.model, duration, starts, controller=code, threads=1, output_step=0.02, **how
        )
        return batch.nodes

    def one_by_one(controller: Any) -> np.ndarray:
        runs = (
            tc.simulate(
                plant.model, duration, start, controller=controller, output_step=0.02,
                **how,
            )
            for start in starts[:_SINGLE]
        )  # fmt: skip
        return np.array([run.nodes for run in runs])

    print(f"controlled: {runs} prisms, {duration:g} s, MPC of {mpc.horizon} samples of 0.02 s")
    print("loops                      simulated s / s  first / these  same bits")
    ways = {
        "compiled, at once": (at_once, runs),
        "compiled, one by one": (lambda: one_by_one(code), len(starts[:_SINGLE])),
        "Python, one by one": (lambda: one_by_one(mpc), len(starts[:_SINGLE])),
    }
    rates, nodes = {}, {}
    for label, (run, count) in ways.items():
        run()
        began = process_time()
        nodes[label] = run()
        rates[label] = count * duration / (process_time() - began)
    first, *_ = ways
    for label, rate in rates.items():
        same = np.array_equal(nodes[first][:_SINGLE], nodes[label][:_SINGLE])
        print(f"{label:25s} {rate:16.0f} {rates[first] / rate:14.1f} {same!s:>10s}")


_SINGLE = 50  # runs that are done one by one


def table(batches: dict[str, Batch], truth: np.ndarray, simulated: float, repeats: int) -> None:
    """Print a row a method that comes near enough, with the step that it needs."""
    chosen = {}
    for label, batch in batches.items():
        for step in STEPS:
            off = np.linalg.norm(batch(step) - truth, axis=1).max(axis=1)
            error = float(np.quantile(np.nan_to_num(off, nan=np.inf), PART, method="higher"))
            if error <= WITHIN:
                chosen[label] = step, error
                break
    seconds: dict[str, list[float]] = {label: [] for label in chosen}
    for _ in range(repeats):
        for label, (step, _) in chosen.items():
            began = process_time()
            batches[label](step)
            seconds[label].append(process_time() - began)
    rates = {label: simulated / min(each) for label, each in seconds.items()}
    best = max(rate for label, rate in rates.items() if label.startswith("tenscontrol"))
    for label, (step, error) in chosen.items():
        ratio = best / rates[label]
        print(f"{label:25s} {step:7.4g} {error:14.1e} {rates[label]:16.0f} {ratio:15.2f}")


_OURS = ("rk4",)


def ours(method: str, model: tc.Model, duration: float, V: np.ndarray, lengths: Any) -> Batch:
    """Return a batch of ours, in one thread."""

    def run(step: float) -> np.ndarray:
        batch = tc.simulate_many(
            model, duration, None, V, rest_length=lengths, method=method, step=step, threads=1
        )
        return batch.nodes[..., -1]

    return run


# ---- peers ----


def slope(xp: Any, prism: tc.Structure, lengths: np.ndarray) -> Callable[..., Any]:
    """Return the accelerations (N, Nd) -> Ndd of one prism with the arrays of NumPy or JAX.

    Nodes are rows, (6, 3) with any axes before; matrices pick and add the ends of members.
    """
    strings, bars = (xp.asarray(_differences(pairs)) for pairs in (prism.strings, prism.bars))
    ends = xp.asarray(abs(_differences(prism.bars)))
    mass, rest = xp.asarray(prism.bar_mass[:, None]), xp.asarray(lengths[:, None])

    def accelerations(N: Any, Nd: Any) -> Any:
        S = strings @ N
        length = xp.sqrt((S * S).sum(axis=-1, keepdims=True))
        pull = xp.maximum(STIFFNESS * (1 - rest / length), 0.0) * S
        F = -(strings.T @ pull)
        B, Bd, f = bars @ N, bars @ Nd, bars @ F
        stretch = mass / 12 * (Bd * Bd).sum(axis=-1, keepdims=True)
        lam = -(stretch + (B * f).sum(axis=-1, keepdims=True) / 2) / (B * B).sum(
            axis=-1, keepdims=True
        )
        half = 3 / mass * f + 6 / mass * lam * B
        return ends.T @ (ends @ F / mass) + bars.T @ half

    return accelerations


def _differences(pairs: np.ndarray) -> np.ndarray:
    matrix = np.zeros((len(pairs), 6))
    matrix[np.arange(len(pairs)), pairs[:, 0]] = -1.0
    matrix[np.arange(len(pairs)), pairs[:, 1]] = 1.0
    return matrix


def columns_slope(prism: tc.Structure, lengths: np.ndarray) -> Callable[..., Any]:
    """Return the accelerations of many prisms at once in NumPy: arrays are (3, 6, runs)."""
    (i, j), (start, end) = prism.strings.T, prism.bars.T
    mass, rest = prism.bar_mass[:, None], lengths[:, None]

    def accelerations(N: np.ndarray, Nd: np.ndarray) -> np.ndarray:
        S = N[:, j] - N[:, i]
        length = np.sqrt(np.einsum("dsr,dsr->sr", S, S))
        S *= np.maximum(STIFFNESS * (1 - rest / length), 0.0)
        F = np.zeros_like(N)
        for k in range(len(i)):
            F[:, i[k]] += S[:, k]
            F[:, j[k]] -= S[:, k]
        B, Bd, f = (part[:, end] - part[:, start] for part in (N, Nd, F))
        stretch = mass / 12 * np.einsum("dbr,dbr->br", Bd, Bd)
        lam = -(stretch + np.einsum("dbr,dbr->br", B, f) / 2) / np.einsum("dbr,dbr->br", B, B)
        half, centre = 3 / mass * f + 6 / mass * lam * B, (F[:, start] + F[:, end]) / mass
        Ndd = np.empty_like(N)
        Ndd[:, start], Ndd[:, end] = centre - half, centre + half
        return Ndd

    return accelerations


def numpy_rk4(model: tc.Model, duration: float, V: np.ndarray, lengths: Any) -> Batch:
    """Return a batch of vectorized NumPy, in blocks that stay in the cache."""
    prism = model.structure
    accelerations = columns_slope(prism, lengths)

    def run(step: float) -> np.ndarray:
        steps, found = round(duration / step), np.empty_like(V)
        for first in range(0, len(V), _CACHED):
            rates = np.ascontiguousarray(V[first : first + _CACHED].transpose(1, 2, 0))
            N = np.repeat(prism.nodes[:, :, None], rates.shape[2], axis=2)
            for _ in range(steps):
                N, rates = rk4_step(accelerations, N, rates, duration / steps)
            found[first : first + _CACHED] = N.transpose(2, 0, 1)
        return found

    return run


_CACHED = 250  # the fastest of 60, 125, 250, 500, 1000


def jax_rk4(model: tc.Model, duration: float, V: np.ndarray, lengths: Any) -> dict[str, Batch]:
    """Return a batch of JAX, compiled for each step; none if it is not installed."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    try:
        import jax
    except ImportError:
        print("JAX is not installed: pip install '.[bench]'")
        return {}
    jax.config.update("jax_enable_x64", True)
    prism = model.structure
    nodes = jax.numpy.asarray(prism.nodes)
    (i, j), (start, end) = prism.strings.T, prism.bars.T
    mass, rest = prism.bar_mass, lengths

    def by_index(N: Any, Nd: Any) -> Any:
        jnp = jax.numpy
        S = N[:, j] - N[:, i]
        pull = jnp.maximum(STIFFNESS * (1 - rest / jnp.sqrt((S * S).sum(axis=0))), 0.0) * S
        F = jnp.zeros_like(N).at[:, i].add(pull).at[:, j].add(-pull)
        B, Bd, f = (part[:, end] - part[:, start] for part in (N, Nd, F))
        lam = -(mass / 12 * (Bd * Bd).sum(axis=0) + (B * f).sum(axis=0) / 2) / (B * B).sum(axis=0)
        half, centre = 3 / mass * f + 6 / mass * lam * B, (F[:, start] + F[:, end]) / mass
        return jnp.zeros_like(N).at[:, start].set(centre - half).at[:, end].set(centre + half)

    by_matrix_rows = slope(jax.numpy, prism, lengths)

    def by_matrix(N: Any, Nd: Any) -> Any:
        return by_matrix_rows(N.T, Nd.T).T

    def batch(accelerations: Callable[..., Any]) -> Batch:
        made: dict[int, Any] = {}

        def run(step: float) -> np.ndarray:
            steps = round(duration / step)

            def one(rates: Any) -> Any:
                def body(state: Any, _: Any) -> Any:
                    return rk4_step(accelerations, *state, duration / steps), None

                return jax.lax.scan(body, (nodes, rates), None, length=steps)[0][0]

            if steps not in made:
                made[steps] = jax.jit(jax.vmap(one))
            return np.asarray(made[steps](jax.numpy.asarray(V)).block_until_ready())

        return run

    # Runs along the last axis take as long.
    return {"JAX vmap, indices": batch(by_index), "JAX vmap, matrices": batch(by_matrix)}


def mujoco_rollout(
    model: tc.Model, duration: float, V: np.ndarray, lengths: Any
) -> dict[str, Batch]:
    """Return batches of MuJoCo's rollout in one thread; none if it is not installed."""
    try:
        import mujoco
        from mujoco import rollout
    except ImportError:
        print("MuJoCo is not installed: pip install '.[bench]'")
        return {}
    texts = [tc.exchange.to_mujoco(model, rest_length=lengths, velocities=rates) for rates in V]
    made = mujoco.MjModel.from_xml_string(texts[0])
    data, reader = mujoco.MjData(made), NodeReader(made, model.structure)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.empty((len(V), mujoco.mj_stateSize(made, kind)))
    for row, text in zip(starts, texts, strict=True):
        own = mujoco.MjModel.from_xml_string(text)
        mujoco.mj_resetDataKeyframe(own, data, 0)
        mujoco.mj_getState(made, data, row, kind)

    def batch(method: int) -> Batch:
        def run(step: float) -> np.ndarray:
            steps = round(duration / step)
            made.opt.integrator, made.opt.timestep = method, duration / steps
            states, _ = rollout.rollout(made, data, starts, nstep=steps)
            read = []
            for state in states[:, -1]:
                mujoco.mj_setState(made, data, state, kind)
                read.append(reader.read(data))
            return reader.motion(read)[0].transpose(2, 0, 1)

        return run

    kinds = mujoco.mjtIntegrator
    methods = {"RK4": kinds.mjINT_RK4, "implicitfast": kinds.mjINT_IMPLICITFAST}
    return {f"MuJoCo rollout {name}": batch(method) for name, method in methods.items()}


if __name__ == "__main__":
    main()
