"""The command ``tenscontrol``."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from tenscontrol._version import __version__
from tenscontrol.files import make_folder, write_file
from tenscontrol.interrupt import InterruptionWarning, finishing, interruptible

if TYPE_CHECKING:
    from tenscontrol.accuracy import Peer
    from tenscontrol.scene import Scene
    from tenscontrol.simulation import Trajectory


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status: 0, or 2 with a message on stderr.

    Ended by Ctrl-C or SIGTERM, it keeps what is done, says so in a line, and returns 130 or 143.
    """
    options = _parser().parse_args(arguments)
    commands = {"demo": _demo, "simulate": _simulate, "modes": _modes, "accuracy": _accuracy}
    ignored = warnings.catch_warnings(action="ignore", category=InterruptionWarning)
    with interruptible() as came, ignored:
        try:
            with suppress(KeyboardInterrupt):
                commands[options.command](options)
                print(end="", flush=True)
                if came.signal is None:
                    return 0
        except (ValueError, ArithmeticError, OSError, MemoryError) as error:
            print(f"tenscontrol: {_told(error)}", file=sys.stderr)
            return 2
    print("tenscontrol: interrupted; what is above was done by then", file=sys.stderr)
    return came.status


def _told(error: Exception) -> str:
    """Return the line that an error is told by."""
    if isinstance(error, MemoryError):
        return f"out of memory: {str(error) or 'ask for less'}"
    if isinstance(error, OSError) and error.errno is not None and error.filename is None:
        # Else Python would try once more to write what is left, at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return f"cannot write to the standard output: {error.strerror}"
    return str(error)


# What a command needs is imported in it, so that --help and --version answer at once.


def _demo(options: argparse.Namespace) -> None:
    from tenscontrol.demo import main as demo

    demo(make_folder(options.output), figures=not options.no_figures)


def _simulate(options: argparse.Namespace) -> None:
    from tenscontrol.scene import load_scene
    from tenscontrol.simulation import SimulationError, load_run

    scene = load_scene(options.scene)
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    start = None if options.start is None else load_run(options.start)
    try:
        run = scene.simulate(progress=True, start=start)
    except SimulationError as error:  # the motion up to there is kept; its figures may overflow
        _keep(error.trajectory, folder)
        raise
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    _keep(run, folder)
    _draw(run, folder)


def _keep(run: Trajectory, folder: Path) -> None:
    """Print the summary of a motion and save it."""
    with finishing():
        saved = run.save(folder / "trajectory.npz")  # also where nobody reads the rest
        print(run.summary())
        print(saved)


def _draw(run: Trajectory, folder: Path) -> None:
    """Save the figures of a motion."""
    from tenscontrol import plot

    drawn = plot.structure(run.structure, run.nodes[:, :, 0], faint=True, legend=False)
    last = run.force_density[:, -1] if len(run.structure.strings) else None
    plot.structure(run.structure, run.nodes[:, :, -1], ax=drawn.ax, force_density=last)
    _save(drawn.ax.figure, folder / "structure.png")
    _save(plot.trajectory(run)["coordinates"].ax.figure, folder / "trajectory.png")
    _save(plot.health(run)["energy"].ax.figure, folder / "health.png")
    if run.control is not None and run.control.estimate is not None:
        _save(plot.estimate(run)["error"].ax.figure, folder / "estimate.png")


def _modes(options: argparse.Namespace) -> None:
    from tenscontrol import plot
    from tenscontrol.plant import modes
    from tenscontrol.scene import load_scene

    scene = load_scene(options.scene)
    try:
        plant = scene.linearize(options.input, options.coordinates)
        found = modes(plant)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    print(f"{plant.input.replace('_', ' ')} held")
    print(found.table())
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    _save(plot.mode_shapes(plant, found)[0].ax.figure, folder / "modes.png")


def _accuracy(options: argparse.Namespace) -> None:
    from tenscontrol.accuracy import work_precision
    from tenscontrol.scene import load_scene

    scene = load_scene(options.scene)
    if options.growth:
        _growth(scene, options)
        return
    names = None if options.methods is None else options.methods.split(",")
    try:
        found = work_precision(
            scene,
            methods=names,
            peers=_peers() if options.peers else (),
            outputs=options.outputs,
            repeats=options.repeats,
            machine_code=options.machine_code,
            progress=True,
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    with finishing():
        saved = found.to_csv(folder / "accuracy.csv")
        page = write_file(folder / "accuracy.md", found.to_markdown())
    if options.csv:
        print(saved.read_text(encoding="utf-8"), end="")
        files = sys.stderr  # so that what is printed is CSV and nothing else
    elif options.markdown:
        print(page.read_text(encoding="utf-8"))
        files = sys.stderr
    else:
        print(found.table())
        if found.peers:
            print("\nrun time by that of our fastest, at equal error")
            print(found.ratios().table())
        files = sys.stdout
    for path in (saved, page):
        print(path, file=files)
    if len(found.failures) < len(found.rows):
        from tenscontrol import plot

        _save(plot.work_precision(found).ax.figure, folder / "accuracy.png", files)


def _growth(scene: Scene, options: argparse.Namespace) -> None:
    """Measure the stops of the road on towers of growing size, and on the structure of a scene."""
    from tenscontrol import plot
    from tenscontrol.accuracy import growth

    budget = {"seconds": options.seconds, "memory": 1e9 * options.memory}
    own = growth([scene.structure], **budget)
    found = growth(**budget, progress=True)
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    with finishing():
        saved = found.to_csv(folder / "growth.csv")
    print(f"{options.scene}\n{own.table()}\n\ntowers of prisms\n{found.table()}\n{saved}")
    for quantity, name in (("seconds", "growth.png"), ("memory", "growth_memory.png")):
        _save(plot.growth(found, quantity).ax.figure, folder / name)


def _peers() -> list[Peer]:
    """Return integrators of other packages, those that are not installed too: they say so."""
    from tenscontrol.accuracy.peers import CasADiCVODES, CasADiRK, MuJoCo, SciPy

    return [
        SciPy("DOP853"),
        SciPy("Radau"),
        CasADiCVODES(),
        CasADiRK(),
        MuJoCo("rk4"),
        MuJoCo("implicit"),
    ]


def _save(figure: Any, path: Path, told: TextIO | None = None) -> None:
    from tenscontrol import plot

    print(plot.save_figure(figure, path), file=told)


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
    accuracy = commands.add_parser(
        "accuracy",
        help="measure error against run time of all methods on a scene file",
        description="Integrate a scene by several methods at several settings, print error, run "
        "time and what is conserved, and save them as accuracy.csv, accuracy.md and accuracy.png. "
        "Of a scene with a controller or faults, the open loop without them is taken.",
    )
    for command in (simulate, modes, accuracy):
        command.add_argument("scene", metavar="SCENE", type=Path, help="scene file (TOML)")
        command.add_argument(
            "--output", type=Path, help="folder for what is saved (default: tenscontrol-<SCENE>)"
        )
    simulate.add_argument(
        "--start",
        metavar="RUN",
        type=Path,
        help="go on from the end of a saved run, a file trajectory.npz",
    )
    accuracy.add_argument(
        "--methods", metavar="A,B", help="our own methods, separated by commas (default: all)"
    )
    accuracy.add_argument(
        "--peers", action="store_true", help="measure SciPy, CasADi and MuJoCo beside"
    )
    accuracy.add_argument(
        "--outputs", type=int, default=100, help="times compared (default: %(default)s)"
    )
    accuracy.add_argument(
        "--repeats",
        type=int,
        default=5,
        help="runs of which the median time is taken (default: %(default)s)",
    )
    accuracy.add_argument(
        "--machine-code",
        action="store_true",
        help="compile our own methods, if there is a compiler",
    )
    accuracy.add_argument(
        "--growth",
        action="store_true",
        help="measure time and memory of each stop from structure to control instead, on the "
        "structure of the scene and on towers of 12 to 100,788 members: growth.csv, growth.png",
    )
    accuracy.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        help="with --growth: most processor time of a stop, s (default: %(default)s)",
    )
    accuracy.add_argument(
        "--memory",
        type=float,
        default=4.0,
        help="with --growth: most memory of a stop, GB (default: %(default)s)",
    )
    printed = accuracy.add_mutually_exclusive_group()
    printed.add_argument("--csv", action="store_true", help="print CSV instead of the table")
    printed.add_argument("--markdown", action="store_true", help="print Markdown instead")
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
