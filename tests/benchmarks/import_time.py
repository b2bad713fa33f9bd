"""Processor time that ``import tenscontrol`` adds to numpy.

Run: ``python -m tests.benchmarks.import_time``.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from statistics import median

from tests.benchmarks.command_line import options

PROGRAM = """
import numpy, time, sys
began = time.process_time()
import tenscontrol
{then}
print(time.process_time() - began)
"""
CASES = {
    "import tenscontrol": "",
    "  and a prism's model": "tenscontrol.Model(tenscontrol.prism()).dynamics",
    "  and python-control, for scale": "import control",
}


def main(arguments: Sequence[str] | None = None) -> None:
    repeats = options(__doc__, arguments, repeats=7).repeats
    for label, then in CASES.items():
        times = [measured(PROGRAM.format(then=then)) for _ in range(repeats)]
        print(f"{label:32s} {median(times):7.4f} s beyond numpy (median of {len(times)})")


def measured(program: str) -> float:
    finished = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return float(finished.stdout)


if __name__ == "__main__":
    main()
