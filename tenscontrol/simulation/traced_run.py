"""Runs whose steps are all kept, a part of them at a time."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.fields import changed
from tenscontrol.integrate.integrator import steps_between
from tenscontrol.simulation.plant_run import PlantRun

# Parts of a part, in which its steps are counted.
_LOOKS = 8


class _Call(NamedTuple):
    """What a run was told to go on under, from a time on, s, for a duration, s."""

    now: float
    held: FloatArray | Pieces
    duration: float
    lengths: Pieces | None


@dataclass(eq=False)
class TracedRun(PlantRun):
    """A run whose steps are kept in parts of about ``most``; each part can be run again.

    What begins a part is kept, and what the run was told in it, so that the same steps are found
    again, to the last bit. ``expected`` is about how many steps there will be in all.
    """

    most: float = np.inf
    expected: float = 0.0
    take: Callable[[PlantRun], None] | None = None  # of the run at the end of a part
    parts: list[tuple[TracedRun, FloatArray, list[_Call]]] = field(init=False, default_factory=list)
    _steps: int = field(init=False, default=0)  # of the run when its part began

    def __post_init__(self) -> None:
        self.traces = True
        super().__post_init__()

    def run(
        self, state: FloatArray, held: FloatArray | tuple[FloatArray, FloatArray] | Pieces,
        duration: float, lengths: Pieces | None = None,
    ) -> FloatArray:  # fmt: skip
        """See :meth:`PlantRun.run`."""
        if isinstance(held, tuple):
            held = Pieces.ramp(self.now, duration, *held)
        begin = self.now
        for end in self._cuts(held, duration):
            if not self.parts or self.work.steps - self._steps >= self.most:
                self.end_part()
                self.parts.append((_copied(self), state, []))
            call = _Call(self.now, held, begin + end - self.now, lengths)
            self.parts[-1][2].append(call)
            state = super().run(state, held, call.duration, lengths)
        return state

    def end_part(self) -> None:
        """Let go of the steps of a part, after they were taken."""
        if self.parts:
            if self.take is not None:
                self.take(self)
            self.spans, self._steps = self.spans[-1:], self.work.steps

    def again(self, part: int) -> PlantRun:
        """Return the run at the end of a part, with its steps."""
        run, state, calls = self.parts[part]
        run = _copied(run)
        for call in calls:
            run.go_to(call.now)
            state = PlantRun.run(run, state, call.held, call.duration, call.lengths)
        return run

    def _cuts(self, held: FloatArray | Pieces, duration: float) -> list[float]:
        """Return where to count the steps, s from now on: between steps, or where inputs change."""
        looks = _LOOKS * self.expected / self.most * duration / self.duration
        if looks <= _LOOKS:
            return [duration]
        whole = duration / looks
        known = [inputs for inputs in (held, self._given) if isinstance(inputs, Pieces)]
        breaks = [t - self.now for p in known for t in p.breaks(self.now, self.now + duration)]
        pieces = np.unique([0.0, *breaks, duration])
        cuts = [0.0]
        while cuts[-1] + 1.5 * whole < duration:
            wanted = cuts[-1] + whole
            i = int(np.searchsorted(pieces, wanted, side="right"))
            begin, length = float(pieces[i - 1]), float(pieces[i] - pieces[i - 1])
            if begin > cuts[-1]:
                wanted = begin
            elif self.integration.step is not None:
                unit = length / steps_between(length, self.output_step)
                if unit == length:
                    unit /= steps_between(length, self.integration.step)
                units = (np.array([cuts[-1], wanted]) - begin) / unit
                wanted = begin + max(round(units[1]), round(units[0]) + 1) * unit
            if wanted > (1 - 1e-9) * duration:
                break
            cuts.append(wanted)
        return [*cuts[1:], duration]


def _copied(original: TracedRun) -> TracedRun:
    """Return a run as it is now, to go on from here."""
    run = changed(original, spans=original.spans[-1:], parts=[], take=None)
    if run.spans:
        run.integrator = copy(original.integrator)
    return run
