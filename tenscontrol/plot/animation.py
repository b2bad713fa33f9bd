"""A motion as a film: an animated GIF, or MP4 by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.files import write_file
from tenscontrol.plot.ground_drawing import add_ground, ground_samples, near_ground, touching
from tenscontrol.plot.structure_drawing import (
    SIZE,
    draw,
    driven_bars,
    fill_figure,
    frame,
    is_slack,
    known_actuation,
    label_view,
    legend_samples,
    new_view,
    passive_strings,
    sample,
)
from tenscontrol.plot.style import FAINT, NORMAL
from tenscontrol.shape.shape_path import ShapePath
from tenscontrol.shape.target import ShapeTarget
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.structure import Structure

# A GIF counts time in hundredths of a second, up to 65,535, and viewers slow down below two.
_SLOWEST, _FASTEST = 0.01, 50.0

# Pixels of all frames, a byte each, and of an inch.
_MOST_PIXELS, _MOST_DOTS = 4e9, 1000

# Drawings of lines need few. One palette for all pictures makes the file a third
# of what matplotlib's PillowWriter makes it, and keeps colours from flickering.
_COLORS = 64

# Pillow takes the mean of similar colours, and paper turns grey.
_NEARLY_WHITE = 247


def write_gif(path: Path, canvas: Any, pictures: Iterable[None], count: int, rate: float) -> None:
    """Write what an Agg canvas shows after each of ``count`` pictures, ``rate`` a second."""
    frames: list[Image.Image] = []
    palette: Image.Image | None = None
    for _ in pictures:
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        if palette is None:
            palette = _palette(picture)
        frames.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
    ends = np.round(100 * np.arange(count + 1) / rate).astype(int)
    buffer = BytesIO()
    frames[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=[10 * int(hundredths) for hundredths in np.diff(ends)],
        loop=0,
    )
    write_file(path, buffer.getvalue())


def write_mp4(path: Path, canvas: Any, pictures: Iterable[None], rate: float) -> None:
    """Write what an Agg canvas shows after each picture, ``rate`` a second, by ffmpeg as H.264."""
    width, height = canvas.get_width_height()
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [
            _ffmpeg(path), "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgba",
            "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "pipe:0",
            # H.264 takes even sizes only, and most players this form of colours only.
            "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white,format=yuv420p",
            "-c:v", "libx264", "-crf", "18", "-movflags", "+faststart", str(film),
        ]  # fmt: skip
        with tempfile.TemporaryFile() as log:
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log)
            assert process.stdin is not None  # a pipe was asked for
            try:
                with suppress(BrokenPipeError), process.stdin as pipe:  # it ended, and says why
                    for _ in pictures:
                        pipe.write(canvas.buffer_rgba())
            except BaseException:  # Ctrl-C too
                process.kill()
                raise
            finally:
                code = process.wait()
            log.seek(0)
            output = log.read().decode(errors="replace").strip()
        if code != 0:
            last = output.splitlines()[-1] if output else "no reason given"
            raise OSError(f"ffmpeg could not write {str(path)!r}: {last}; or write a .gif")
        write_file(path, film.read_bytes())


def _ffmpeg(path: Path) -> str:
    """Return where ffmpeg is."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise FileNotFoundError(
            f"path is {str(path)!r}, but the program ffmpeg, which writes .mp4 files, was not "
            "found: install it and have it on PATH, or give a path that ends in .gif"
        )
    return program


def _palette(picture: Image.Image) -> Image.Image:
    """Return an image whose palette is that of the picture, with the paper purely white."""
    colors = np.array(picture.quantize(_COLORS).getpalette(), dtype=np.uint8).reshape(-1, 3)
    colors[colors.min(axis=1) >= _NEARLY_WHITE] = 255
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors.ravel().tolist())
    return palette


def animate(
    run: Trajectory | ShapePath,
    path: str | PathLike[str],
    *,
    fps: float = 20.0,
    duration: float | None = None,
    target: object = None,
    view: tuple[float, float] = (20.0, -60.0),
    dpi: int = 100,
) -> Path:
    """Write a motion as an animated GIF, which repeats without end, or as an MP4 film.

    The frames are equally spaced in time, the first and the last state among
    them, and nothing but the structure moves. Slack strings are dotted, and nodes that press on the
    ground are marked.

    Parameters
    ----------
    run : Trajectory or ShapePath
    path : str or path
        Where to write; ends in ``.gif``, or in ``.mp4``, which needs the program ffmpeg. A file
        that is there is replaced.
    fps : float
        Frames a second, 0.01 to 50.
    duration : float, optional
        Time that the animation takes, s; as long as the motion if not given,
        so that it plays in real time.
    target : array_like, shape (d, n), or Structure, Prestress or ShapeTarget, optional
        Node positions of a shape to draw faintly, m: where the motion should go. It is drawn where
        it is given; a free structure may reach the shape at another place.
    view : tuple of two floats
        Elevation and azimuth of the eye, degrees; of no use in the plane.
    dpi : int
        Pixels an inch; the picture is 5.0 inches wide and 4.5 high.

    Returns
    -------
    Path
        Where the file is.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, does not fit or is not finite, or
        ``path`` does not end in ``.gif`` or ``.mp4``. Nothing is written then.
    OSError
        If the folder of ``path`` is not there, ffmpeg is not found, or the file cannot be written:
        a file that was there is as it was.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> run = tc.simulate(model, 0.15, force_density=[17.3205] * 6 + [9.0] * 3, step=1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tc.plot.animate(run, Path(folder) / "prism.gif", fps=10)
    ...     path.name, path.stat().st_size > 0
    ('prism.gif', True)
    """
    if isinstance(run, ShapePath):
        moved = _Motion(run.model.structure, run.time, run.nodes, run.force_density)
    else:
        validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
        moved = _Motion(
            run.structure, run.time, run.nodes, run.force_density, run.ground, run.contacts
        )
    if isinstance(target, Structure | Prestress | ShapeTarget):
        target = target.nodes
    file = validation.file_path("path", path, [".gif", ".mp4"])
    if not file.parent.is_dir():
        raise FileNotFoundError(f"path is {str(file)!r}, but its folder is not there; make it")
    is_film = file.suffix.lower() == ".mp4"
    if is_film:
        _ffmpeg(file)
    rate, count, dots = _frames(moved, fps, duration, dpi)
    eye = validation.float_array("view", view)
    if eye.shape != (2,):
        raise ValueError(f"view has shape {eye.shape}, expected (2,): elevation and azimuth")
    motion = validation.float_array("run.nodes", moved.nodes)
    validation.float_array("run.force_density", moved.force_density)
    goal = None if target is None else moved.structure.checked_nodes("target", target)
    times = np.linspace(moved.time[0], moved.time[-1], count)
    scene = _Scene(moved, _sampled(moved, motion, times), goal, eye, dots)
    if is_film:
        write_mp4(file, scene.canvas, scene.pictures(times), rate)
    else:
        write_gif(file, scene.canvas, scene.pictures(times), count, rate)
    return file


@dataclass(frozen=True, eq=False)
class _Motion:
    """What is shown of a run or path."""

    structure: Structure
    time: FloatArray
    nodes: FloatArray
    force_density: FloatArray
    ground: tuple[ContactLaw, ...] = ()
    contacts: ContactRecord | None = None


def _frames(run: _Motion, fps: float, duration: float | None, dpi: int) -> tuple[float, int, int]:
    """Return frames a second, their number, and pixels an inch, after checking them."""
    rate = validation.positive_number("fps", fps, "1/s")
    if not _SLOWEST <= rate <= _FASTEST:
        raise ValueError(
            f"fps is {rate:g}, expected at least {_SLOWEST:g} and at most {_FASTEST:g}: a "
            "GIF cannot be slower, and viewers are not faster"
        )
    length = float(run.time[-1] - run.time[0]) if duration is None else duration
    if duration is not None:
        length = validation.positive_number("duration", duration, "s")
    dots = validation.whole_number("dpi", dpi, least=10, most=_MOST_DOTS)
    pixels = length * rate * SIZE[0] * SIZE[1] * dots**2
    if pixels > _MOST_PIXELS:
        raise ValueError(
            f"duration is {length:g} s, which at fps={rate:g} and dpi={dots} makes {pixels:.1e} "
            f"pixels, expected at most {_MOST_PIXELS:.0e}: give a shorter one, or fewer of them"
        )
    return rate, max(2, round(length * rate)), dots


class _Scene:
    """Axes and legend, which stand still and are drawn once, and what moves upon a copy of them."""

    def __init__(
        self,
        run: _Motion,
        sampled: tuple[FloatArray, FloatArray, IntArray],
        goal: FloatArray | None,
        eye: FloatArray,
        dots: int,
    ) -> None:
        self._run, self._sampled = run, sampled
        shapes, gammas, _ = sampled
        d = self._dimension = run.structure.dimension
        figure = Figure(figsize=SIZE, dpi=dots)
        canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
        self.canvas = canvas
        fill_figure(figure, d)
        ax = self._ax = new_view(figure, d)
        passive, struts = passive_strings(run.structure, known_actuation(run)), driven_bars(run)
        slack = any(is_slack(gamma).any() for gamma in gammas.T)
        samples = legend_samples(run.structure, slack, passive=passive, struts=struts)
        samples += ground_samples(run.ground)
        if goal is not None:
            draw(ax, run.structure, goal, FAINT)
            samples.append(sample("target", color=FAINT.bar_color, linewidth=FAINT.bar_width))
        drawing = draw(ax, run.structure, shapes[:, :, 0], NORMAL, passive, struts)
        everywhere = [shapes.reshape(d, -1)]
        everywhere += [near_ground(run.ground, everywhere[0])]
        frame(ax, everywhere if goal is None else [*everywhere, goal], grow=False)
        label_view(ax)
        if d == 3:
            ax.view_init(elev=float(eye[0]), azim=float(eye[1]))
        if run.ground:
            ground, marks = add_ground(ax, run.ground, np.zeros((d, 0)), len(run.structure.bars))
            drawing = replace(drawing, ground=ground, touching=marks)
        figure.legend(
            handles=samples, loc="upper left", frameon=False, fontsize="small", ncols=5 - d
        )
        self._drawing = drawing
        self._clock = figure.text(0.97, 0.96, "", ha="right", va="top")
        members = [
            artist for artist in (*ax.collections, *ax.lines) if artist not in drawing.ground
        ]
        self._moving = [*sorted(members, key=lambda artist: artist.get_zorder()), self._clock]
        for artist in self._moving:
            artist.set_animated(True)
        canvas.draw()
        self._still = canvas.copy_from_bbox(figure.bbox)

    def pictures(self, times: FloatArray) -> Iterator[None]:
        """Draw one frame after the other on the canvas."""
        shapes, gammas, states = self._sampled
        frames = zip(times, np.moveaxis(shapes, 2, 0), gammas.T, states, strict=True)
        for time, shape, gamma, state in frames:
            self._drawing.update(shape, gamma, touching(self._run.contacts, state))
            self._clock.set_text(f"t = {time:.2f} s")
            self.canvas.restore_region(self._still)
            if self._dimension == 3:
                for lines in self._ax.collections:
                    lines.do_3d_projection()
            for artist in self._moving:
                artist.draw(self.canvas.get_renderer())
            yield


def _sampled(
    run: _Motion, motion: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return nodes between the states, (d, n, frames), γ there, (α, frames), and the states."""
    after = np.clip(np.searchsorted(run.time, times), 0, len(run.time) - 1)
    before = np.maximum(after - 1, 0)
    gap = run.time[after] - run.time[before]
    share = np.where(gap > 0, (times - run.time[before]) / np.where(gap > 0, gap, 1.0), 1.0)
    shapes = motion[:, :, before] * (1 - share) + motion[:, :, after] * share
    return shapes, run.force_density[:, after], after
