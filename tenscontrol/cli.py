"""The command ``tenscontrol``."""
# PYTHON_ARGCOMPLETE_OK

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, cast

from tenscontrol._version import __version__
from tenscontrol.files import make_folder, write_file
from tenscontrol.interrupt import InterruptionWarning, finishing, interruptible
from tenscontrol.options import command_parser

if TYPE_CHECKING:
    from tenscontrol.accuracy.peers.peer import Peer
    from tenscontrol.simulation.trajectory import Trajectory

# Status of a command whose output nobody reads any more: that of other tools, 128 + SIGPIPE.
_CLOSED = 141


class _Output:
    """The standard output, for any terminal and any reader.

    What is written after the reader closed the pipe is dropped. Signs that the terminal cannot show
    are written by their codes.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self.closed = stream, False

    def write(self, text: str) -> int:
        """Write a text, unless the pipe is closed."""
        with self._dropping():
            try:
                self._stream.write(text)
            except UnicodeEncodeError as error:
                shown = text.encode(error.encoding, "backslashreplace").decode(error.encoding)
                self._stream.write(shown)
        return len(text)

    def flush(self) -> None:
        """Write what is left in the buffer."""
        with self._dropping():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _dropping(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            self.closed = True
            # What is in the buffer goes there, now and at the end of Python.
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status: 0, or 2 with a message on stderr.

    After Ctrl-C or SIGTERM it keeps what is done, says so in a line, and returns 130 or 143. If
    the reader of a pipe goes away, it finishes without a message, and returns 141.
    """
    # There are no streams where the shell closed them, and under pythonw.
    output, messages = _Output(sys.stdout or StringIO()), sys.stderr or StringIO()
    try:
        with redirect_stdout(cast(TextIO, output)), redirect_stderr(messages):
            try:
                status = _run(arguments)
            finally:
                output.flush()  # what --help printed too
    except OSError as error:
        print(f"tenscontrol: {_told(error)}", file=messages)
        return 2
    return _CLOSED if output.closed and not status else status


def _run(arguments: Sequence[str] | None) -> int:
    parser = command_parser()
    _complete(parser)
    options = parser.parse_args(arguments)
    commands = {
        "demo": _demo, "new": _new, "simulate": _simulate, "modes": _modes, "view": _view,
        "accuracy": _accuracy,
    }  # fmt: skip
    options.summary = sys.stdout if getattr(options, "json", False) else None
    apart = nullcontext() if options.summary is None else redirect_stdout(sys.stderr)
    ignored = warnings.catch_warnings(action="ignore", category=InterruptionWarning)
    with interruptible() as came, ignored, apart:
        try:
            with suppress(KeyboardInterrupt):
                commands[options.command](options)
                print(end="", flush=True)
                if came.signal is None:
                    return 0
        except (ValueError, ArithmeticError, OSError, MemoryError, ImportError) as error:
            print(f"tenscontrol: {_told(error)}", file=sys.stderr)
            return 2
    print("tenscontrol: interrupted; what is above was done by then", file=sys.stderr)
    return came.status


def _complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell if it asks for completions; it says so in the environment."""
    if "_ARGCOMPLETE" in os.environ:
        with suppress(ImportError):  # without the extra there is no completion
            import argcomplete

            argcomplete.autocomplete(parser)


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


def _new(options: argparse.Namespace) -> None:
    from tenscontrol.scene.template import scene_names, scene_template

    if options.list:
        names = scene_names()
        width = max(map(len, names))
        print(*(f"{name:<{width}}  {title}" for name, title in names.items()), sep="\n")
        return
    if options.name is None:
        raise ValueError("NAME is missing; tenscontrol new --list shows all names")
    text = scene_template(options.name)
    path = options.output or Path(f"{options.name}.toml")
    if path.is_file() and not options.force:
        raise ValueError(f"{path} exists already; give another --output, or --force to replace it")
    print(write_file(path, text))


def _simulate(options: argparse.Namespace) -> None:
    from tenscontrol.scene.load_scene import load_scene
    from tenscontrol.simulation.health_check import SimulationError
    from tenscontrol.simulation.trajectory import load_run

    scene = load_scene(options.scene, options.allow_code)
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    start = None if options.start is None else load_run(options.start)
    try:
        run = scene.simulate(progress=True, start=start)
    except SimulationError as error:  # the motion up to there is kept; its figures may overflow
        _report_run(error.trajectory, options, [_keep(error.trajectory, folder)])
        raise
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    files = [_keep(run, folder), *_draw(run, folder)]
    _report_run(run, options, files)


def _keep(run: Trajectory, folder: Path) -> Path:
    """Print the summary of a motion and save it."""
    with finishing():
        saved = run.save(folder / "trajectory.npz")  # also where nobody reads the rest
        print(run.summary())
        print(saved)
    return saved


def _report_run(run: Trajectory, options: argparse.Namespace, files: list[Path]) -> None:
    if options.json:
        from tenscontrol.summaries import of_run

        _print_json(options, of_run(run), files)


def _print_json(
    options: argparse.Namespace, summary: dict[str, Any], files: Sequence[Path]
) -> None:
    """Print a summary to the standard output; all else is on stderr then."""
    from tenscontrol.summaries import json_text

    head = {"command": options.command, "version": __version__, "scene": options.scene}
    print(json_text(head | summary | {"files": files}), file=options.summary, flush=True)


def _draw(run: Trajectory, folder: Path) -> list[Path]:
    """Save the figures of a motion and return their files."""
    from tenscontrol import plot

    drawn = plot.structure(run.structure, run.nodes[:, :, 0], faint=True, legend=False)
    last = run.force_density[:, -1] if len(run.structure.strings) else None
    plot.structure(run.structure, run.nodes[:, :, -1], ax=drawn.ax, force_density=last)
    files = [
        _save(drawn.ax.figure, folder / "structure.png"),
        _save(plot.trajectory(run)["coordinates"].ax.figure, folder / "trajectory.png"),
        _save(plot.health(run)["energy"].ax.figure, folder / "health.png"),
    ]
    if run.control is not None and run.control.estimate is not None:
        files.append(_save(plot.estimate(run)["error"].ax.figure, folder / "estimate.png"))
    return files


def _modes(options: argparse.Namespace) -> None:
    from tenscontrol import plot
    from tenscontrol.plant.modes import modes
    from tenscontrol.scene.load_scene import load_scene

    scene = load_scene(options.scene, options.allow_code)
    try:
        plant = scene.linearize(options.input, options.coordinates)
        spectrum = modes(plant)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    print(f"{plant.input.replace('_', ' ')} held")
    print(spectrum.table())
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    figure = _save(plot.mode_shapes(plant, spectrum)[0].ax.figure, folder / "modes.png")
    if options.json:
        from tenscontrol.summaries import of_modes

        _print_json(options, of_modes(plant, spectrum), [figure])


def _view(options: argparse.Namespace) -> None:
    from tenscontrol.plot.web_page import plotly_js
    from tenscontrol.scene.load_scene import load_scene
    from tenscontrol.simulation.trajectory import Trajectory, load_run

    plotly_js()  # where it is missing, say so before the simulation
    is_run = options.scene.suffix == ".npz"
    source = load_run(options.scene) if is_run else load_scene(options.scene, options.allow_code)
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    try:
        run = source if isinstance(source, Trajectory) else source.simulate(progress=True)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    page = run.to_html(folder / "view.html")
    print(page)
    if sys.stdout.isatty() if options.browser is None else options.browser:
        import webbrowser

        webbrowser.open(page.absolute().as_uri())


def _accuracy(options: argparse.Namespace) -> None:
    from tenscontrol.accuracy.work_precision import work_precision
    from tenscontrol.scene.load_scene import load_scene

    scene = load_scene(options.scene, options.allow_code)
    names = None if options.methods is None else options.methods.split(",")
    try:
        comparison = work_precision(
            scene,
            methods=names,
            peers=_peers() if options.peers else (),
            outputs=options.outputs,
            repeats=options.repeats,
            progress=True,
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"{options.scene}: {error}") from error
    folder = make_folder(options.output or Path(f"tenscontrol-{options.scene.stem}"))
    with finishing():
        saved = comparison.to_csv(folder / "accuracy.csv")
        page = write_file(folder / "accuracy.md", comparison.to_markdown())
    if options.csv:
        print(saved.read_text(encoding="utf-8"), end="")
        files = sys.stderr  # so that what is printed is CSV and nothing else
    elif options.markdown:
        print(page.read_text(encoding="utf-8"))
        files = sys.stderr
    else:
        print(comparison.table())
        if comparison.peers:
            print("\nrun time by that of our fastest, at equal error")
            print(comparison.ratios().table())
        files = sys.stdout
    paths = [saved, page]
    for path in paths:
        print(path, file=files)
    if len(comparison.failures) < len(comparison.rows):
        from tenscontrol import plot

        paths.append(
            _save(plot.work_precision(comparison).ax.figure, folder / "accuracy.png", files)
        )
    if options.json:
        from tenscontrol.summaries import of_comparison

        _print_json(options, of_comparison(comparison), paths)


def _peers() -> list[Peer]:
    """Return integrators of other packages, those that are not installed too: they say so."""
    from tenscontrol.accuracy.peers.ode_solvers import CasADiCVODES, CasADiRK, SciPy
    from tenscontrol.accuracy.peers.rigid_bodies import MuJoCo

    return [
        SciPy("DOP853"),
        SciPy("Radau"),
        CasADiCVODES(),
        CasADiRK(),
        MuJoCo("rk4"),
        MuJoCo("implicit"),
    ]


def _save(figure: Any, path: Path, stream: TextIO | None = None) -> Path:
    from tenscontrol import plot

    print(plot.save_figure(figure, path), file=stream)
    return path
