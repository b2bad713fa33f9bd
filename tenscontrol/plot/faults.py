"""Faults of a run in its time histories."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tenscontrol.plot.axes import legend_above
from tenscontrol.plot.history import Curves
from tenscontrol.plot.style import REFERENCE_COLOR, REFERENCE_WIDTH, reference_style
from tenscontrol.simulation import CutString, Trajectory
from tenscontrol.validation import FloatArray


def with_faults(panel: Curves, run: Trajectory) -> Curves:
    """Mark faults in a panel: a line where a string is cut, a bracket while something is broken."""
    if not run.faults:
        return panel
    marks, last = dict(panel.marks), float(run.time[-1])
    for position, fault in enumerate(fault for fault in run.faults if fault.start <= last):
        end = min(fault.end, last)
        for_good = isinstance(fault, CutString)
        times, heights = ([fault.start] * 2, [0, 1]) if for_good else (
            [fault.start, fault.start, end, end], [0, 1, 1, 0]
        )  # fmt: skip
        style = reference_style(position) | {"linewidth": REFERENCE_WIDTH * (1 if for_good else 2)}
        (marks[f"{fault.label} at {fault.start:g} s"],) = panel.ax.plot(
            times,
            heights,
            transform=panel.ax.get_xaxis_transform(),
            zorder=1.7,
            marker="x" if for_good else "none",
            markeredgecolor=REFERENCE_COLOR,
            label=f"{fault.label} at {fault.start:g} s",
            **style,
        )
    legend_above(panel.ax)
    return replace(panel, marks=marks)


def wound(run: Trajectory) -> FloatArray:
    """Return the rest lengths of a run, those of cut strings left out, NaN, shape (α, T)."""
    assert run.rest_length is not None  # callers draw rest lengths
    shown = run.rest_length.copy()
    for fault in run.faults:
        if isinstance(fault, CutString):
            shown[fault.string, (run.time > fault.time) | (fault.time == 0)] = np.nan
    return shown
