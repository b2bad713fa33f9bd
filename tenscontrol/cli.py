"""The command ``tenscontrol``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tenscontrol._version import __version__


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process if not given.

    Returns
    -------
    int
        Exit status.
    """
    options = _parser().parse_args(arguments)
    # Imported here so that --help and --version answer at once.
    from tenscontrol.demo import main as demo

    try:
        options.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"tenscontrol: cannot write figures to {options.output}: {error}")
        return 1
    demo(options.output, figures=not options.no_figures)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tenscontrol", description="Tensegrity structures: modes, LQR, MPC, simulation."
    )
    parser.add_argument("--version", action="version", version=f"tenscontrol {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    demo = commands.add_parser(
        "demo",
        help="check, analyse and control a prism, and draw what happens",
        description="Check the equilibrium of a prism, print its modes and LQR poles, move it to "
        "a new height by MPC, and save the figures.",
    )
    demo.add_argument(
        "--output",
        type=Path,
        default=Path("tenscontrol-demo"),
        help="folder for the figures (default: %(default)s)",
    )
    demo.add_argument("--no-figures", action="store_true", help="print only")
    return parser
