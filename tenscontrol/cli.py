"""The command ``tenscontrol``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tenscontrol._version import __version__

if TYPE_CHECKING:
    from tenscontrol.simulation import Trajectory


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process if not given.

    Returns
    -------
    int
        Exit status: 0, or 2 with a message on stderr.
    """
    options = _parser().parse_args(arguments)
    commands = {"demo": _demo, "simulate": _simulate, "modes": _modes}
    try:
        commands[options.command](options)
    except (ValueError, ArithmeticError, OSError) as error:
        print(f"tenscontrol: {error}", file=sys.stderr)
        return 2
    return 0


# What a command needs is imported in it, so that --help and --version answer at once.


def _demo(options: argparse.Namespace) -> None:
    from tenscontrol.demo import main as demo

    demo(_folder(options.output), figures=not options.no_figures)


def _simulate(options: argparse.Namespace) -> None:
    from tenscontrol.scene import load_scene
    from tenscontrol.simulation import SimulationError

    scene = load_scene(options.scene)
    folder = _folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    try:
        run = scene.simulate(progress=True)
    except SimulationError as error:  # the motion up to there is kept; its figures may overflow
        _keep(error.trajectory, folder)
        raise
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    _keep(run, folder)
    _draw(run, folder)


def _keep(run: Trajectory, folder: Path) -> None:
    """Print the summary of a motion and save it."""
    from tenscontrol.scene import save_trajectory

    print(run.summary())
    print(save_trajectory(run, folder / "trajectory.npz"))


def _draw(run: Trajectory, folder: Path) -> None:
    """Save the figures of a motion."""
    from tenscontrol import plot

    drawn = plot.structure(run.structure, run.nodes[:, :, 0], faint=True, legend=False)
    last = run.force_density[:, -1] if len(run.structure.strings) else None
    plot.structure(run.structure, run.nodes[:, :, -1], ax=drawn.ax, force_density=last)
    _save(drawn.ax.figure, folder / "structure.png")
    _save(plot.trajectory(run)["coordinates"].ax.figure, folder / "trajectory.png")
    _save(plot.health(run)["energy"].ax.figure, folder / "health.png")


def _modes(options: argparse.Namespace) -> None:
    from tenscontrol import plot
    from tenscontrol.analysis import modes
    from tenscontrol.scene import load_scene

    scene = load_scene(options.scene)
    try:
        plant = scene.linearize(options.input, options.coordinates)
        found = modes(plant)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    print(f"{plant.input.replace('_', ' ')} held")
    print(found.table())
    folder = _folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    _save(plot.mode_shapes(plant, found)[0].ax.figure, folder / "modes.png")


def _folder(path: Path) -> Path:
    """Return a folder that is there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot write to {path}: {error.strerror or error}") from error
    return path


def _save(figure: Any, path: Path) -> None:
    from tenscontrol import plot

    print(plot.save_figure(figure, path))


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
    simulate = commands.add_parser(
        "simulate",
        help="simulate a scene file, save the motion and its figures",
        description="Simulate a scene, print what tells whether to trust the motion, and save it "
        "as trajectory.npz with the figures trajectory.png, health.png and structure.png.",
    )
    modes = commands.add_parser(
        "modes",
        help="print and draw the modes of a scene file that is at rest",
        description="Linearize a scene about its shape, which must be at rest, print its modes "
        "and save the figure modes.png.",
    )
    for command in (simulate, modes):
        command.add_argument("scene", metavar="SCENE", type=Path, help="scene file (TOML)")
        command.add_argument(
            "--output", type=Path, help="folder for what is saved (default: tenscontrol-<SCENE>)"
        )
    modes.add_argument(
        "--input",
        choices=("force_density", "rest_length"),
        help="what the actuators hold (default: as the scene says)",
    )
    modes.add_argument(
        "--coordinates",
        choices=("internal", "minimal", "nodes"),
        default="internal",
        help="motions taken in: of the shape, with those as one body, of all nodes "
        "(default: %(default)s)",
    )
    return parser
