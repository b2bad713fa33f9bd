"""The suite of stiff and extreme cases, run by one call or one command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tenscontrol.accuracy.suite.extreme import methods
from tenscontrol.accuracy.suite.result import SuiteResult
from tenscontrol.accuracy.suite.scenes import extremes
from tenscontrol.accuracy.suite.truth import truth
from tenscontrol.accuracy.suite.verdict import Verdict, judge
from tenscontrol.progress import progress_bar
from tenscontrol.validation import truth as checked_truth


def extreme_suite(quick: bool = False, only: str = "", progress: bool = False) -> SuiteResult:
    """Run every method on stiff and extreme structures, and say what came of each.

    Strings of 1 to 1e9 N/m, masses of a milligram beside a kilogram, a string
    of 64 segments, bars that turn at 1000 rad/s, prestress from 1e-6 to 1e6 N/m, slack
    strings, strings at zero length, needles and coins, steps too long, long
    runs, damping, sizes from microns to kilometres. In each the true motion is
    known in closed form, or computed by two methods that have little in
    common. Every run is accurate, or says in a warning or an error that it is
    not, or is not started as too long; else it is silently wrong, which is
    what the suite is to find.

    Parameters
    ----------
    quick : bool
        Whether to run a few cases only, in some seconds; all take minutes.
    only : str
        Only cases with this in their name.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    SuiteResult

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, or no case has that name.

    Examples
    --------
    >>> from tenscontrol.accuracy.suite import extreme_suite
    >>> found = extreme_suite(quick=True, only="free bar")
    >>> len(found.silent), found.methods[:3]
    (0, ('rk4', 'rattle', 'rattle4'))
    """
    checked_truth("quick", quick, "whether to run a few cases only")
    checked_truth("progress", progress, "whether to show a progress bar")
    cases = [case for case in extremes(quick) if only in case.name]
    if not cases:
        groups = ", ".join(dict.fromkeys(case.group for case in extremes(quick)))
        raise ValueError(f"only is {only!r}, found in none of the cases: {groups}")
    rows: list[Verdict] = []
    names = methods()
    with progress_bar(len(cases), progress, "suite", "cases") as report:
        for case in cases:
            known = truth(case)
            for method in names:
                rows.append(judge(case, known, method))
                report(len(rows) / len(names))
    return SuiteResult(tuple(rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the suite from the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process if not given.

    Returns
    -------
    int
        Exit status: 0, 1 where a run was silently wrong, or 2 with a message
        on stderr.
    """
    options = _parser().parse_args(arguments)
    try:
        found = extreme_suite(options.quick, options.only, progress=True)
        if options.csv is not None:
            found.to_csv(options.csv)
        if options.markdown is not None:
            options.markdown.write_text(found.to_markdown(), encoding="utf-8")
    except (ValueError, ArithmeticError, OSError) as error:
        print(f"suite: {error}", file=sys.stderr)
        return 2
    print(found.table())
    return 1 if found.silent else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tenscontrol.accuracy.suite",
        description="Run every integration method on stiff and extreme structures, and print "
        "which is accurate, which warns, stops or is too long. Exit status 1 if a run is "
        "silently wrong.",
    )
    parser.add_argument("--quick", action="store_true", help="a few cases only")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with this in their name")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="save every run with its reason")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="save the table")
    return parser
