"""Rest lengths as states of a planned motion, which motors with inertia turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.actuation.driven_strings import forces_on_inputs
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.evaluator import Function, builds
from tenscontrol.optimize.collocation import (
    STAGES,
    DiscreteMotion,
    Instant,
    MotionProgram,
    Rows,
    gauss_points,
    stacked,
    zero,
)
from tenscontrol.optimize.motion_limits import MotionLimits
from tenscontrol.statics.prestress import Prestress


class MotorStates:
    """Rest lengths among the places of a motion, and the forces of the motors as its input.

    With m the inertia of a motor as a mass, f its force and T that of its strings, m l̈0 = T − f.
    """

    def __init__(self, limits: MotionLimits, ends: tuple[Prestress, Prestress]) -> None:
        assert limits.inertia is not None  # else there are no such states
        self._limits, self._inertia = limits, limits.inertia
        self._held = [
            forces_on_inputs(
                limits.actuation, end.force_density * end.structure.string_length()
            )
            for end in ends
        ]  # fmt: skip

    @builds
    def program(self, program: MotionProgram) -> MotionProgram:
        """Return a program whose input are rest lengths with the motors that turn them."""
        limits, count = self._limits, len(self._inertia)
        assert program.ends is not None  # of rest lengths
        first, last = program.ends
        half, speed = len(program.start), program.size / program.time
        x, v = (ca.SX.sym(name, half + count) for name in ("x", "v"))
        force = ca.SX.sym("force", count)
        now = self._seen(Instant(x, v, force, None))
        turned = (limits.state(now).pull - force) / ca.DM(self._inertia)
        moved = program.acceleration(now.places, now.velocities, now.input)

        def end(places: Any, velocities: Any) -> Rows:
            rows = program.end(places[:half], velocities[:half])
            off = (places[half:] - ca.DM(last)) / program.size
            return stacked([rows, zero(off, "goal"), zero(velocities[half:] / speed, "rest")])

        power = program.power
        return replace(
            program,
            acceleration=Function("acceleration", [x, v, force], [ca.vertcat(moved, turned)]),
            limits=lambda now: program.limits(self._seen(now)),
            cost_rate=lambda now: program.cost_rate(self._seen(now)),
            tie_rate=lambda now: program.tie_rate(self._seen(now)),
            power=None if power is None else lambda now: power(self._seen(now)),
            end=end,
            start=np.concatenate([program.start, first]),
            input_range=np.array([-limits.pull, limits.pull]),
            rate_limit=np.full(count, np.inf),
            ends=None,
            unit=float(limits.pull.max()),
        )

    def _seen(self, now: Instant) -> Instant:
        """Return an instant as one whose input are rest lengths."""
        half = now.places.numel() - len(self._inertia)
        x, v = now.places, now.velocities
        return Instant(x[:half], v[:half], x[half:], v[half:], now.input)

    def guess(self, motion: DiscreteMotion) -> DiscreteMotion:
        """Return a guess, from one whose input are rest lengths, with forces that hold the ends."""
        share = np.linspace(0.0, 1.0, motion.begin.shape[1] + 1)
        force = np.outer(self._held[0], 1 - share) + np.outer(self._held[1], share)
        lengths = np.column_stack([motion.begin, motion.end[:, -1]])
        rates = np.gradient(lengths, share * motion.duration, axis=1)
        rates[:, [0, -1]] = 0.0
        return DiscreteMotion(
            motion.duration,
            np.vstack([motion.places, lengths]),
            np.vstack([motion.velocities, rates]),
            force[:, :-1],
            force[:, 1:],
            np.concatenate([motion.stage_places, _between(lengths)]),
            np.concatenate([motion.stage_velocities, _between(rates)]),
        )

    def wound(self, motion: DiscreteMotion) -> DiscreteMotion:
        """Return a motion as one whose input are rest lengths."""
        half = len(motion.places) - len(motion.begin)
        lengths, rates = motion.places[half:], motion.velocities[half:]
        return DiscreteMotion(
            motion.duration, motion.places[:half], motion.velocities[:half], lengths[:, :-1],
            lengths[:, 1:], motion.stage_places[:half], motion.stage_velocities[:half], rates,
        )  # fmt: skip


def _between(values: FloatArray) -> FloatArray:
    """Return values at Gauss points, shape (m, s, K), linear between those at ends, (m, K + 1)."""
    share = gauss_points(STAGES)[1:, None]
    return np.asarray((1 - share) * values[:, None, :-1] + share * values[:, None, 1:])
