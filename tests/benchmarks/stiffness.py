"""LQR and MPC that command γ, and rest lengths, against stiffness: the prism of 0.85 m.

Run: ``python -m tests.benchmarks.stiffness``. Winches hold rest lengths over 0.02 s samples; the
strings are slightly damped (c = 0.02 √k). MPC moves the prism from 1 m to 0.85 m in 2 s, LQR
holds it there after a push. About a minute: the integrator follows vibrations of 3500 rad/s at the
end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from examples.stiffness_study import stiffness_report
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options

STIFFNESS = (1e2, 3e2, 1e3, 3e3, 1e4, 1e5, 1e6)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, stiffness=STIFFNESS)
    prism = tc.prism()
    report = stiffness_report(
        tc.prestress(demo.prism_of_height(prism, demo.TARGET), demo.TOP_FORCE_DENSITY),
        given.stiffness,
        sample_time=demo.SAMPLE,
        damping=lambda k: 0.02 * np.sqrt(k),
        reference=demo.ramp(prism, 1.0, demo.TARGET, 2.0),
        max_force_density=55.0,
        progress=True,
    )
    print(report.summary())


if __name__ == "__main__":
    main()
