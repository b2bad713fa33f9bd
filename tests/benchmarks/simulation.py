"""Five seconds of the prism with slack strings: error against run time, beside peers.

Run: ``python -m tests.benchmarks.simulation``. MuJoCo takes part if it is installed
(extra ``bench``). Errors are those of node 0 over all milliseconds, against an
independent rigid-body model with every slack-taut switch located. Times are of the
integration alone, for all; ratios are to the first row, from one run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np
from scipy.integrate import solve_ivp

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.integrate import RK4
from tests.benchmarks.command_line import options
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.oracle import HeldRestLength, RigidBars

DURATION, REPEATS, STEP, STIFFNESS = 5.0, 5, 1e-3, 100.0


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, duration=DURATION, repeats=REPEATS)
    duration, outputs = given.duration, round(given.duration / STEP)
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(STIFFNESS))
    l0 = rest_lengths(prism, paper_force_density(9.0), STIFFNESS)
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    times = STEP * np.arange(1, outputs + 1)
    law = HeldRestLength(l0, STIFFNESS)
    truth, switches = RigidBars(prism, law).integrate(
        prism.nodes, np.zeros((3, 6)), np.concatenate([[0.0], times])
    )
    truth = truth[:, 0, 1:]

    integrator = RK4(model.equation("rest_length"), STEP)
    evaluator = Evaluator(model.rest_length_dynamics)

    def ours() -> np.ndarray:
        return integrator.advance(state, l0, duration, outputs).states[:3]

    def scipy_run(tolerance: float) -> Callable[[], np.ndarray]:
        def run() -> np.ndarray:
            return solve_ivp(
                lambda t, x: evaluator(x, l0)[0].copy(), (0.0, times[-1]), state,
                method="DOP853", t_eval=times, rtol=tolerance, atol=tolerance,
            ).y[:3]  # fmt: skip

        return run

    runs = {"tenscontrol rk4, step 1e-3": ours}
    runs |= {f"SciPy DOP853, {t:g}": scipy_run(t) for t in (1e-4, 1e-6, 1e-8)}
    runs |= mujoco_runs(model, l0, outputs)
    print(f"prism, γ_v = 9 N/m, k = {STIFFNESS:g} N/m, {duration:g} s, {len(switches)} switches")
    print("method                        error m     time s  time / first")
    first = None
    for label, run in runs.items():
        seconds, path = timed(run, given.repeats)
        first = first or seconds
        error = np.linalg.norm(path - truth, axis=0).max()
        print(f"{label:28s} {error:8.1e} {seconds:10.4f} {seconds / first:9.1f}")


def timed(run: Callable[[], np.ndarray], repeats: int) -> tuple[float, np.ndarray]:
    """Return the median time of some repeats, s, and the path of node 0."""
    path = run()
    times = []
    for _ in range(repeats):
        began = perf_counter()
        run()
        times.append(perf_counter() - began)
    return float(np.median(times)), path


def mujoco_runs(own: tc.Model, l0: np.ndarray, outputs: int) -> dict[str, Callable[[], np.ndarray]]:
    """Return runs of MuJoCo with spatial tendons as strings; none if it is not installed."""
    try:
        import mujoco
    except ImportError:
        print("MuJoCo is not installed: pip install '.[bench]'")
        return {}
    model = mujoco.MjModel.from_xml_string(tc.exchange.to_mujoco(own, rest_length=l0, step=STEP))
    data = mujoco.MjData(model)
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "n0")

    def run_with(method: int) -> Callable[[], np.ndarray]:
        def run() -> np.ndarray:
            model.opt.integrator = method
            mujoco.mj_resetData(model, data)
            mujoco.mj_forward(model, data)
            path = np.empty((3, outputs))
            for k in range(outputs):
                mujoco.mj_step(model, data)
                # A step leaves the sites where its last stage had them.
                mujoco.mj_kinematics(model, data)
                path[:, k] = data.site_xpos[site]
            return path

        return run

    return {
        "MuJoCo RK4, step 1e-3": run_with(mujoco.mjtIntegrator.mjINT_RK4),
        "MuJoCo implicit, step 1e-3": run_with(mujoco.mjtIntegrator.mjINT_IMPLICIT),
    }


if __name__ == "__main__":
    main()
