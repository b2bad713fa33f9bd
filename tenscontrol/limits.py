"""How much one call may ask for: memory, time, and whole numbers that compiled code can count with.

Far above what is sensible, and far below what ends a process or a day.
"""

from __future__ import annotations

#: C code, CasADi and OSQP count in 32 bits.
LARGEST_WHOLE = 2**31 - 1
#: The seeds of NumPy's generators hold 128 bits.
LARGEST_SEED = 2**128 - 1
#: Runs, outputs and draws of one call.
MOST_RUNS = 10_000_000
#: Samples of a horizon or a delay, and substeps of a sample.
MOST_SAMPLES = 10_000
#: Plants and controllers that one call designs.
MOST_DESIGNS = 1_000

#: Seconds that a call may take, or wait for a program: a day.
LONGEST_WAIT = 86_400.0

_MOST_BYTES = 4e9


def refuse_memory(asked: str, count: float, things: str, each: float, hint: str = "") -> None:
    """Raise if ``count`` things of ``each`` bytes do not fit; ``asked``: "sides is 9"."""
    if not count * each <= _MOST_BYTES:
        raise ValueError(
            f"{asked}, which makes {count:.3g} {things}, about {count * each / 1e9:.3g} GB of "
            f"memory; expected at most {_MOST_BYTES / each:.2g}, {_MOST_BYTES / 1e9:g} GB{hint}"
        )


def refuse_time(asked: str, count: float, things: str, each: float, hint: str = "") -> None:
    """Raise if ``count`` things of ``each`` seconds are not done in a day."""
    if not count * each <= LONGEST_WAIT:
        raise ValueError(
            f"{asked}, which makes {count:.3g} {things}, about {count * each / 86_400:.3g} days; "
            f"expected at most {LONGEST_WAIT / each:.2g}, a day{hint}"
        )
