"""Error against run time on the paper's example 1, beside MuJoCo, SciPy and CVODES.

``python -m tests.benchmarks.error_against_time [--massive] [--all]``: a prism released
with slack strings, 5 s, massless or with four massive segments a string. Times are of the
processor: of our methods of a second ``tc.simulate``, whole, with its checks and its trajectory, of
peers of their integration; what is built before is the column ``building``. The tables are the time
of a peer over that of our fastest method, at errors that both reach. With ``--all``
every run is told, with ``--settings 3`` each method has its three coarsest settings. Needs
the extra ``bench``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import CasADiCVODES, MuJoCo, SciPy
from tests.benchmarks.command_line import options

STEPS = (0.05, 0.04, 0.025, 0.02, 0.0125, 0.01, 0.005, 0.0025, 0.001, 5e-4, 2.5e-4)
SETTINGS = {
    "rk4": STEPS[2:],
    "dop853": tuple(10.0**-k for k in range(3, 13)),
}


def example(segments: int, duration: float) -> tc.Scene:
    """The paper's example 1: γ = 17.3205 N/m, but 9 N/m in the vertical strings."""
    prism = tc.prism()
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    stiffness = 100.0
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    if segments == 1:
        return tc.Scene(model, duration, rest_length=lengths, name="massless strings")
    # The paper's node mass: a string of 0.04 kg on a bar of 1 kg.
    cut = tc.subdivide(prism, segments=segments, node_mass=0.04 / segments)
    massive = tc.Model(cut, strings=tc.LinearStrings(stiffness * segments))
    value = tc.structure.spread_rest_length(cut, lengths)
    return tc.Scene(massive, duration, rest_length=value, name=f"{segments} segments")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    given = options(
        __doc__, arguments, massive=False, all=False, duration=5.0,
        settings=len(STEPS), repeats=60,  # most runs take milliseconds
    )  # fmt: skip
    case = example(4 if given.massive else 1, given.duration)
    scale = 0.25 if given.massive else 1.0
    settings = {
        name: tuple(x if name == "dop853" else scale * x for x in values[: given.settings])
        for name, values in SETTINGS.items()
    }
    mujoco = tuple(scale * x for x in (2e-2, 1e-2, 5e-3, 2.5e-3, 1e-3, 5e-4, 2.5e-4, 1e-4))
    tolerances = tuple(10.0**-k for k in range(3, 13))
    peers = [
        *(
            MuJoCo(kind, settings=mujoco[: given.settings])
            for kind in ("rk4", "euler", "implicitfast")
        ),
        SciPy("DOP853", settings=tolerances[: given.settings]),
        CasADiCVODES(settings=tolerances[:-1][: given.settings]),
    ]
    found = tc.work_precision(
        case,
        list(settings),
        settings,
        peers,
        repeats=given.repeats,
        outputs=max(1, round(10 * given.duration)),
        progress=True,
    )
    errors = [10.0**-k for k in range(3, 9 if given.massive else 10)]
    print(case.name)
    print(found.summary())
    if given.all:
        print(found.table())
    ratios = found.ratios(errors)
    print(ratios.table())


if __name__ == "__main__":
    main()
