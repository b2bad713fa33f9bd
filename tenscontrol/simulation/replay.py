"""Replay of a run at another resolution, which tells its error."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.simulation.error_estimate import Motion, Path, Stage
from tenscontrol.simulation.plant_run import PlantRun


def estimated_error(
    run: PlantRun, limit: float, is_controlled: bool, report: Callable[[float], None] | None
) -> FloatArray | None:
    """Return an estimate of the error of the nodes at all times kept; None if interrupted.

    ``limit`` is that up to which the motion is trusted; ``report`` is told the time reached, s.
    """
    stages, half = [], len(run.model.structure.free_rows)
    for i, (before, span) in enumerate(pairwise(run.spans)):
        start = float(before.time[-1])
        u = run.packed(span.coefficients, start - span.origin)
        # The motion is kept from after a jump at its start on.
        begin = partial(run.pushed, held=u, jump=span.jump if i else None)
        stages.append(Stage(float(span.time[-1]) - start, len(span.time), u, begin))
    positions = np.hstack([span.states[:half] for span in run.spans[1:]])
    starts = None
    if is_controlled:  # a controller corrects the motion
        starts = np.column_stack([span.begin for span in run.spans[1:]])
    motion = Motion(
        run.model.structure, run.spans[0].begin, stages,
        Path(np.arange(positions.shape[1]), positions, run.work.switches + run.work.missed),
        np.arange(half), run.choice.setting, run.choice.value, run.order, run.integrator_for,
        run.equation.layout.later, starts, report,
    )  # fmt: skip
    try:
        return frozen(np.concatenate([[0.0], motion.estimated_error(limit)]))
    except KeyboardInterrupt:
        return None
