"""The command line of ``tenscontrol``: commands, options, help."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tenscontrol._version import __version__
from tenscontrol.configuration import core_line


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="tenscontrol",
        description="Simulate and control tensegrity structures.",
        epilog="example:\n  tenscontrol new six_bar_ball\n  tenscontrol simulate six_bar_ball.toml",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    about = f"tenscontrol {__version__}, {core_line()}"
    parser.add_argument("--version", action="version", version=about)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_demo(commands)
    _add_new(commands)
    _add_simulate(commands)
    _add_modes(commands)
    _add_view(commands)
    _add_accuracy(commands)
    return parser


def _command(
    commands: Any, name: str, summary: str, description: str, *examples: str
) -> argparse.ArgumentParser:
    """Return the parser of a new command, with its help and its examples."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=summary,
        description=description,
        epilog="\n  ".join(["example:", *examples]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser


def _add_scene(
    parser: argparse.ArgumentParser, name: str = "SCENE", meaning: str = "scene file (TOML)"
) -> None:
    """Add what all commands that read a scene have."""
    parser.add_argument("scene", metavar=name, type=Path, help=meaning)
    parser.add_argument(
        "--output",
        metavar="FOLDER",
        type=Path,
        help="folder for the files (default: tenscontrol-SCENE in this folder)",
    )
    parser.add_argument(
        "--allow-code",
        action="store_true",
        help="run the Python code that the scene names for its controller; read it first",
    )


def _add_json(parser: Any) -> None:
    parser.add_argument(
        "--json",
        action="store_true",
        help="print a summary as JSON; everything else goes to stderr",
    )


def _add_demo(commands: Any) -> None:
    demo = _command(
        commands,
        "demo",
        "analyse and control a prism, with figures",
        "Check the equilibrium of a prism and print its modes and its LQR poles. Move it\n"
        "to a new height by MPC. Save the figures.",
        "tenscontrol demo --output figures",
    )
    demo.add_argument(
        "--output",
        metavar="FOLDER",
        type=Path,
        default=Path("tenscontrol-demo"),
        help="folder for the figures (default: %(default)s)",
    )
    demo.add_argument("--no-figures", action="store_true", help="do not draw figures")


def _add_new(commands: Any) -> None:
    new = _command(
        commands,
        "new",
        "write a commented scene file for a structure of the library",
        "Write a scene file for a structure of the library. Each key has a comment with its\n"
        "unit and its meaning. The scene runs as it is.",
        "tenscontrol new --list",
        "tenscontrol new class2_tower --output tower.toml",
        "tenscontrol simulate tower.toml",
    )
    name: Any = new.add_argument("name", metavar="NAME", nargs="?", help="name of the structure")
    name.completer = _names
    new.add_argument("--list", action="store_true", help="list the structures and stop")
    new.add_argument("--output", metavar="FILE", type=Path, help="scene file (default: NAME.toml)")
    new.add_argument("--force", action="store_true", help="replace the file if it exists")


def _names(**_: object) -> list[str]:
    """Return the names of the structures, for completion."""
    from tenscontrol.library import __all__

    return list(__all__)


def _add_simulate(commands: Any) -> None:
    simulate = _command(
        commands,
        "simulate",
        "simulate a scene, save the motion and its figures",
        "Simulate a scene. Print the figures that tell whether to trust the motion, and how the\n"
        "controller did. Save trajectory.npz, trajectory.png, health.png and structure.png.",
        "tenscontrol simulate scene.toml --output run",
    )
    _add_scene(simulate)
    simulate.add_argument(
        "--start",
        metavar="RUN",
        type=Path,
        help="go on from the end of a saved run, a file trajectory.npz",
    )
    _add_json(simulate)


def _add_modes(commands: Any) -> None:
    modes = _command(
        commands,
        "modes",
        "print and draw the natural frequencies and mode shapes of a scene",
        "Linearize a scene about its shape, which must be in equilibrium. Print the natural\n"
        "frequencies and damping ratios, and save the mode shapes as modes.png.",
        "tenscontrol modes scene.toml --input rest_length",
    )
    _add_scene(modes)
    _add_json(modes)
    modes.add_argument(
        "--input",
        choices=("force_density", "rest_length"),
        help="what the actuators hold constant (default: as in the scene)",
    )
    modes.add_argument(
        "--coordinates",
        choices=("internal", "minimal", "nodes"),
        default="internal",
        help="internal: changes of shape; minimal: rigid-body motions too; nodes: all node "
        "coordinates (default: %(default)s)",
    )


def _add_view(commands: Any) -> None:
    view = _command(
        commands,
        "view",
        "show the motion of a scene or a saved run in the browser",
        "Simulate a scene, or load a run, and write view.html, a page on which the motion is\n"
        "turned and played. The page needs no network. Writing it needs the package plotly.",
        "tenscontrol view six_bar_ball.toml",
        "tenscontrol view tenscontrol-six_bar_ball/trajectory.npz",
    )
    _add_scene(view, "SCENE|RUN", "scene file (TOML), or saved run (npz)")
    view.add_argument(
        "--browser",
        action=argparse.BooleanOptionalAction,
        help="open the page in the browser (default: if the output is a terminal)",
    )


def _add_accuracy(commands: Any) -> None:
    accuracy = _command(
        commands,
        "accuracy",
        "measure error and run time of the integration methods on a scene",
        "Integrate a scene by several methods at several steps or tolerances. Print error, run\n"
        "time and drift of energy and momentum, and save them as accuracy.csv, accuracy.md and\n"
        "accuracy.png. A controller and faults of the scene are left out.",
        "tenscontrol accuracy scene.toml --methods rk4,dop853",
    )
    _add_scene(accuracy)
    accuracy.add_argument(
        "--methods", metavar="A,B", help="methods, separated by commas (default: all)"
    )
    accuracy.add_argument(
        "--peers", action="store_true", help="measure SciPy, CasADi and MuJoCo as well"
    )
    accuracy.add_argument(
        "--outputs",
        metavar="N",
        type=int,
        default=100,
        help="number of times at which errors are taken (default: %(default)s)",
    )
    accuracy.add_argument(
        "--repeats",
        metavar="N",
        type=int,
        default=5,
        help="number of runs; their median time is printed (default: %(default)s)",
    )
    printed = accuracy.add_mutually_exclusive_group()
    printed.add_argument("--csv", action="store_true", help="print CSV instead of the table")
    printed.add_argument("--markdown", action="store_true", help="print Markdown instead")
    _add_json(printed)
