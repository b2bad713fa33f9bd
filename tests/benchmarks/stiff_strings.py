"""Slow motion under stiff strings: evaluations that the implicit method needs, and an explicit one.

``python -m tests.benchmarks.stiff_strings [--duration 5] [--segments 4]``: the prism with strings
of 1e8 N/m in four segments with nodes of 0.01 g, tumbling and twisting slowly. The explicit method
is RK4 at nine tenths of its largest stable step; its motion is also the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.open_loop import fastest_rate
from tests.benchmarks.command_line import options

STIFFNESS, NODE_MASS, SEGMENTS = 1e8, 1e-5, 4
OUTPUTS = 100  # a second


def scene(segments: int, duration: float) -> tc.Scene:
    """The cut prism at rest under γ = 17.3205 N/m, turning at 0.2 to 1 rad/s and twisting."""
    prism = tc.prism()
    rest = tc.prestress(prism, force_density=17.3205)
    model = tc.Model(prism, strings=tc.LinearStrings(STIFFNESS))
    lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    cut = tc.subdivide(prism, segments=segments, node_mass=NODE_MASS)
    spin = np.cross([0.2, 0.3, 1.0], cut.nodes.T).T
    # The mechanism of the prism: top and bottom turn against each other and part.
    level = cut.nodes[2] - cut.nodes[2].mean()
    twist = 0.2 * level * np.cross([0.0, 0.0, 1.0], cut.nodes.T).T
    velocities = _without_stretch(cut, spin + twist)
    massive = tc.Model(cut, strings=tc.LinearStrings(STIFFNESS * segments))
    value = tc.structure.spread_rest_length(cut, lengths)
    return tc.Scene(massive, duration, velocities=velocities, rest_length=value)


def _without_stretch(structure, velocities):
    """Return the nearest velocities, by least squares, that stretch neither bars nor strings."""
    members = np.vstack([structure.bars, structure.strings])
    rows = np.zeros((len(members), velocities.size))
    for row, (start, end) in zip(rows, members, strict=True):
        along = structure.nodes[:, end] - structure.nodes[:, start]
        row[3 * start : 3 * start + 3], row[3 * end : 3 * end + 3] = -along, along
    flat = velocities.ravel(order="F")
    flat = flat - np.linalg.pinv(rows, rcond=1e-9) @ (rows @ flat)
    return flat.reshape(velocities.shape, order="F")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    given = options(__doc__, arguments, duration=5.0, segments=SEGMENTS)
    duration = given.duration
    case = scene(given.segments, duration)
    frequency = fastest_rate(case)
    longest = np.sqrt(8) / frequency
    print(f"largest frequency {frequency:.3g} rad/s; RK4 is stable to {longest:.2e} s")
    rows, reference = [], None
    runs = [("rk4", 0.9 * longest), *(("energy_momentum", h) for h in (1e-3, 5e-4, 2.5e-4))]
    for name, step in runs:
        began = process_time()
        run = tc.simulate(
            case.model, duration, velocities=case.velocities, rest_length=case.input_value,
            method=name, step=step, error="none", output_step=1 / OUTPUTS,
        )  # fmt: skip
        taken = process_time() - began
        reference = run.nodes if reference is None else reference
        rows.append((name, step, np.abs(run.nodes - reference).max(), run.evaluations, taken))
    moved = np.abs(reference - reference[:, :, :1]).max()
    print(f"{duration:g} s, nodes move up to {moved:.2f} m")
    titles = ("method", "step s", "error m", "evaluations", "share", "time s")
    print("{:>16} {:>9} {:>9} {:>12} {:>8} {:>8}".format(*titles))
    for name, value, error, evaluations, taken in rows:
        share = evaluations / rows[0][3]
        print(f"{name:>16} {value:9.2e} {error:9.1e} {evaluations:12d} {share:8.2%} {taken:8.1f}")


if __name__ == "__main__":
    main()
