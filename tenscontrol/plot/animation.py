"""A motion as an animated GIF."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from tenscontrol.dynamics import ContactLaw, checked_grounds
from tenscontrol.files import write_file
from tenscontrol.plot.structure_drawing import (
    SIZE,
    draw,
    fill_figure,
    frame,
    is_slack,
    label_view,
    legend_samples,
    new_view,
    sample,
)
from tenscontrol.plot.style import FAINT, NORMAL
from tenscontrol.simulation import Trajectory
from tenscontrol.validation import (
    FloatArray,
    file_path,
    float_array,
    instance,
    positive_number,
    whole_number,
)

# A GIF counts time in hundredths of a second, up to 65,535, and viewers slow down below two.
_SLOWEST, _FASTEST = 0.01, 50.0

# Pixels of all frames, a byte each, and of an inch.
_MOST_PIXELS, _MOST_DOTS = 4e9, 1000

# Lines of the net that shows a plane.
_NET = 9

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
    write_file(path, buffer.getbuffer())


def _palette(picture: Image.Image) -> Image.Image:
    """Return an image whose palette is that of the picture, with the paper purely white."""
    colors = np.array(picture.quantize(_COLORS).getpalette(), dtype=np.uint8).reshape(-1, 3)
    colors[colors.min(axis=1) >= _NEARLY_WHITE] = 255
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors.ravel().tolist())
    return palette


def animate(
    run: Trajectory,
    path: str | PathLike[str],
    *,
    fps: float = 20.0,
    duration: float | None = None,
    target: object = None,
    ground: ContactLaw | Sequence[ContactLaw] | None = None,
    view: tuple[float, float] = (20.0, -60.0),
    dpi: int = 100,
) -> Path:
    """Write a motion as an animated GIF, which repeats without end.

    The frames are equally spaced in time, the first and the last state among
    them, and nothing but the structure moves. Slack strings are dotted.

    Parameters
    ----------
    run : Trajectory
    path : str or path
        Where to write; ends in ``.gif``. A file that is there is replaced.
    fps : float
        Frames a second, 0.01 to 50.
    duration : float, optional
        Time that the animation takes, s; as long as the motion if not given,
        so that it plays in real time.
    target : array_like, shape (d, n), optional
        Node positions of a shape to draw faintly, m: where the motion should go. It is drawn where
        it is given; a free structure may reach the shape at another place.
    ground : ContactLaw or sequence of ContactLaw, optional
        Planes of which the part under the motion is drawn faintly: ``model.ground``.
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
        ``path`` does not end in ``.gif``. Nothing is written then.
    OSError
        If the folder of ``path`` is not there, or the file cannot be written: a file that was there
        is as it was.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> run = tc.simulate(model, 0.2, force_density=[17.3205] * 6 + [9.0] * 3, step=1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tc.plot.animate(run, Path(folder) / "prism.gif", fps=10)
    ...     path.name, path.stat().st_size > 0
    ('prism.gif', True)
    """
    instance("run", run, Trajectory, "make one by simulate(model, ...)")
    place = file_path("path", path, [".gif"])
    if not place.parent.is_dir():
        raise FileNotFoundError(f"path is {str(place)!r}, but its folder is not there; make it")
    rate = positive_number("fps", fps, "1/s")
    if not _SLOWEST <= rate <= _FASTEST:
        raise ValueError(
            f"fps is {rate:g}, expected at least {_SLOWEST:g} and at most {_FASTEST:g}: a "
            "GIF cannot be slower, and viewers are not faster"
        )
    length = float(run.time[-1] - run.time[0]) if duration is None else duration
    if duration is not None:
        length = positive_number("duration", duration, "s")
    dots = whole_number("dpi", dpi, least=10, most=_MOST_DOTS)
    pixels = length * rate * SIZE[0] * SIZE[1] * dots**2
    if pixels > _MOST_PIXELS:
        raise ValueError(
            f"duration is {length:g} s, which at fps={rate:g} and dpi={dots} makes {pixels:.1e} "
            f"pixels, expected at most {_MOST_PIXELS:.0e}: give a shorter one, or fewer of them"
        )
    eye = float_array("view", view)
    if eye.shape != (2,):
        raise ValueError(f"view has shape {eye.shape}, expected (2,): elevation and azimuth")
    motion = float_array("run.nodes", run.nodes)
    float_array("run.force_density", run.force_density)
    goal = None
    if target is not None:
        goal = run.structure.checked_nodes("target", target)
    grounds = checked_grounds(ground, run.structure)
    times = np.linspace(run.time[0], run.time[-1], max(2, round(length * rate)))
    shapes, gammas = _sampled(run, motion, times)
    figure = Figure(figsize=SIZE, dpi=dots)
    canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
    d = run.structure.dimension
    fill_figure(figure, d)
    ax = new_view(figure, d)
    samples = legend_samples(run.structure, any(is_slack(gamma).any() for gamma in gammas.T))
    if goal is not None:
        draw(ax, run.structure, goal, FAINT)
        samples.append(sample("target", color=FAINT.bar_color, linewidth=FAINT.bar_width))
    drawing = draw(ax, run.structure, shapes[:, :, 0], NORMAL)
    everywhere = [shapes.reshape(d, -1)]
    everywhere += [_draw_plane(ax, law, everywhere[0]) for law in grounds]
    frame(ax, everywhere if goal is None else [*everywhere, goal], grow=False)
    label_view(ax)
    if d == 3:
        ax.view_init(elev=float(eye[0]), azim=float(eye[1]))
    figure.legend(handles=samples, loc="upper left", frameon=False, fontsize="small", ncols=5 - d)
    clock = figure.text(0.97, 0.96, "", ha="right", va="top")
    # Axes and legend stand still: they are drawn once, and what moves upon a copy of them.
    moving = [*sorted((*ax.collections, *ax.lines), key=lambda each: each.get_zorder()), clock]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)

    def pictures() -> Iterator[None]:
        for time, shape, gamma in zip(times, np.moveaxis(shapes, 2, 0), gammas.T, strict=True):
            drawing.update(shape, gamma)
            clock.set_text(f"t = {time:.2f} s")
            canvas.restore_region(still)
            if d == 3:
                for members in ax.collections:
                    members.do_3d_projection()
            for artist in moving:
                artist.draw(canvas.get_renderer())
            yield

    write_gif(place, canvas, pictures(), len(times), rate)
    return place


def _draw_plane(ax: Any, law: ContactLaw, points: FloatArray) -> FloatArray:
    """Draw the part of a plane that is below some points as a net, and return its nodes."""
    if not isinstance(law.height, float):
        raise ValueError("ground is curved, expected planes: leave it out")
    normal = law.up(len(points))
    tangents = [np.eye(len(points))[i] for i in np.argsort(np.abs(normal))[: len(points) - 1]]
    tangents[0] = tangents[0] - (tangents[0] @ normal) * normal
    tangents[0] /= np.linalg.norm(tangents[0])
    if len(points) == 3:
        tangents[1] = np.cross(normal, tangents[0])
    ends = [np.linspace(min(along), max(along), _NET) for along in np.array(tangents) @ points]
    across = np.array(np.meshgrid(*ends, indexing="ij"))
    net = np.tensordot(np.transpose(tangents), across, 1)
    net += law.height * normal.reshape(-1, *[1] * len(tangents))
    style = {"color": FAINT.bar_color, "linewidth": FAINT.string_width, "zorder": 0}
    for lines in (net, net.swapaxes(1, -1)) if len(points) == 3 else (net[:, None],):
        for line in np.moveaxis(lines, 1, 0):
            ax.plot(*line, **style)
    return net.reshape(len(points), -1)


def _sampled(
    run: Trajectory, motion: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return node positions between the states, (d, n, frames), and γ there, (α, frames)."""
    after = np.clip(np.searchsorted(run.time, times), 0, len(run.time) - 1)
    before = np.maximum(after - 1, 0)
    gap = run.time[after] - run.time[before]
    share = np.where(gap > 0, (times - run.time[before]) / np.where(gap > 0, gap, 1.0), 1.0)
    shapes = motion[:, :, before] * (1 - share) + motion[:, :, after] * share
    return shapes, run.force_density[:, after]
