"""Final height of the prism against stiffness: MPC that commands γ, and rest lengths.

Run: ``python -m tests.benchmarks.stiffness``. Winches hold rest lengths over 0.02 s samples; the
strings are slightly damped (c = 0.02 √k); the prism is moved from 1 m to 0.85 m in 2 s. A few
minutes: the integrator follows vibrations of 3500 rad/s at the end.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol import demo
from tenscontrol.control import held_loop
from tests.benchmarks.command_line import options

STIFFNESS = (1e2, 3e2, 1e3, 3e3, 1e4, 1e5, 1e6)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, stiffness=STIFFNESS)
    print("                    MPC in γ                        MPC in rest lengths")
    print("k, N/m     settling/design  largest error     largest error  median OSQP iterations")
    for stiffness in given.stiffness:
        rows = [final_error(stiffness, held) for held in ("force_density", "rest_length")]
        (ratio, by_gamma, _), (_, by_length, work) = rows
        print(
            f"{stiffness:7.0e} {ratio:14.2f} {by_gamma:16s} {by_length:18s} {work:8.0f}", flush=True
        )


def final_error(stiffness, held):
    """Return the predicted rate ratio, the largest error of the last second, and iterations."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness, damping=0.02 * np.sqrt(stiffness)))
    target = demo.prism_of_height(prism, demo.TARGET)
    plant = tc.linearize(model, tc.prestress(target, demo.TOP_FORCE_DENSITY), input=held)
    path = demo.ramp(prism, 1.0, demo.TARGET, 2.0)
    limit = 55.0 if held == "force_density" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that γ will not hold: shown as figures
        mpc = tc.MPC(plant, 20, demo.SAMPLE, limit, reference=path)
    ratio = np.nan
    if held == "force_density":
        Q, R = tc.energy_weights(plant)
        law = tc.lqr(plant, Q, 0.1 * R, step=demo.SAMPLE)
        ratio = held_loop(plant, law.gain, demo.SAMPLE).rate_ratio
    step = min(2e-3, 0.3 / np.sqrt(12 * stiffness))
    try:
        run = tc.simulate(model, 4.0, prism.nodes, controller=mpc, step=step, output_step=2e-3)
    except tc.SimulationError:
        return ratio, "runs away", 0.0
    height = demo.height_of(run.nodes[:, :, run.time > 3.0])
    error = 1e3 * np.abs(height - demo.TARGET).max()
    return ratio, f"{error:9.3f} mm", float(np.median(mpc.statistics.iterations))


if __name__ == "__main__":
    main()
