"""The moving picture of the README, and the figures of the first pages.

``python -m tests.pictures`` writes them into ``docs/images``. It takes a minute.
"""

import argparse
import contextlib
import runpy
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from PIL import Image

import tenscontrol as tc
from tests.code_blocks import PROJECT, blocks, run
from tests.plot.test_view_in_browser import CHROMIUM, Browser

IMAGES = PROJECT / "docs" / "images"
SAMPLE, REST_LENGTH, FACE = 0.05, 0.55, [0, 4, 8]  # s, m; the nodes it stands on at the start
FRAMES_A_SECOND, COLORS = 10, 48
BAR, SHADOW, FLOOR = "#1b2a41", "0.80", "0.88"
TENSION = LinearSegmentedColormap.from_list("tension", ["#7cc0f0", "#2a6fdb", "#d62246"])


def rolled(duration):
    """Return the run of a six-bar ball that rolls along x on flat ground for a time, s."""
    ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.02)
    strings = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    model = tc.Model(ball, strings=strings, gravity=9.81, ground=ground)
    winches = tc.Winches(rate=0.2, shortest=0.35, longest=0.8, ramp=True)
    gait = tc.shape.RollingGait(model, REST_LENGTH, [1.0, 0.0, 0.0], SAMPLE, winches=winches)
    return tc.simulate(
        model,
        duration,
        nodes=tc.plant.set_down(model, FACE),
        controller=gait,
        winches=winches,
        rest_length=REST_LENGTH,
        output_step=SAMPLE,
    )


def pictures(run):
    """Yield a picture of each frame: bars dark, strings coloured by tension, shadows on a floor."""
    structure = run.structure
    lengths = [structure.string_length(nodes) for nodes in np.moveaxis(run.nodes, 2, 0)]
    tension = run.force_density * np.transpose(lengths)
    low, high = run.nodes.min(axis=(1, 2)), run.nodes.max(axis=(1, 2))
    sides = [np.arange(np.floor(low[k] * 2) / 2, high[k] + 0.5, 0.5) for k in (0, 1)]
    figure = plt.figure(figsize=(6.4, 3.2), dpi=100)
    ax = figure.add_axes((-0.12, -0.45, 1.24, 1.9), projection="3d", computed_zorder=False)
    ax.set_axis_off()
    ax.view_init(elev=12.0, azim=-78.0)
    ends = [side[[0, -1]] for side in sides]
    floor = [[(x, ends[1][0], 0), (x, ends[1][1], 0)] for x in sides[0]]
    floor += [[(ends[0][0], y, 0), (ends[0][1], y, 0)] for y in sides[1]]
    ax.add_collection3d(Line3DCollection(floor, colors=FLOOR, linewidths=0.8, zorder=0))
    looks = {
        "shadow": (structure.bars, {"colors": SHADOW, "linewidths": 3.0, "zorder": 1}),
        "strings": (structure.strings, {"cmap": TENSION, "linewidths": 1.6, "zorder": 2}),
        "bars": (structure.bars, {"colors": BAR, "linewidths": 4.5, "zorder": 3}),
    }
    drawn = {}
    for name, (members, look) in looks.items():
        drawn[name] = members, Line3DCollection(run.nodes[:, members, 0].transpose(1, 2, 0), **look)
        ax.add_collection3d(drawn[name][1])
    drawn["strings"][1].set_clim(*np.quantile(tension, [0.02, 0.98]))
    ax.set(xlim=ends[0], ylim=ends[1], zlim=(0.0, 1.0))
    ax.set_box_aspect([np.ptp(ends[0]), np.ptp(ends[1]), 1.0], zoom=1.25)
    every = round(1 / (FRAMES_A_SECOND * SAMPLE))
    for k in range(0, len(run.time), every):
        nodes = run.nodes[:, :, k]
        for name, (members, lines) in drawn.items():
            flat = nodes * [[1.0], [1.0], [0.0]] if name == "shadow" else nodes
            lines.set_segments(flat[:, members].transpose(1, 2, 0))
        drawn["strings"][1].set_array(tension[:, k])
        figure.canvas.draw()
        yield Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    plt.close(figure)


def rolling_ball(path, duration=11.0):
    """Write the six-bar ball that rolls; return its number of frames."""
    frames = list(pictures(rolled(duration)))
    some = np.vstack([np.asarray(frame) for frame in frames[::10]])  # all colours that there are
    palette = Image.fromarray(some).quantize(COLORS)
    colors = np.array(palette.getpalette(), dtype=np.uint8).reshape(-1, 3)
    colors[colors.min(axis=1) > 247] = 255  # white stays white on a white page
    palette.putpalette(colors.ravel().tolist())
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    frames[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=1000 // FRAMES_A_SECOND,
        loop=0,
    )
    return len(frames)


def first_pages(folder):
    """Write the figures of the pages on the first structure, from what the pages define."""
    names = {}
    for page in ("first_structure", "modes", "lqr"):
        for block in blocks(page):
            if block.language == "python":
                run(block, names)
    plant, modes = names["plant"], names["modes"]
    drawn = tc.plot.structure(names["ball"], labels=True)
    tight = {"dpi": 110, "bbox_inches": "tight"}
    drawn.ax.figure.savefig(folder / "first_structure.png", **tight)
    shapes = tc.plot.mode_shapes(plant, modes, which=[0, 1, 4])
    shapes[0].ax.figure.savefig(folder / "modes.png", **tight)
    away = {
        label: 1e3 * np.linalg.norm(each.nodes - plant.nodes[:, :, None], axis=0).max(axis=0)
        for label, each in {"rest lengths held": names["held"], "LQR": names["run"]}.items()
    }
    curves = tc.plot.history(names["run"].time, away, "farthest node from rest, mm")
    curves.ax.figure.savefig(folder / "lqr.png", **tight)


def trust(folder):
    """Write the figures of the page on trust, from what the page defines; return the errors."""
    names = {}
    for block in blocks("trust"):
        if block.language == "python" and not block.fragment:
            run(block, names)
    figure, axes = plt.subplots(3, 1, figsize=(6.4, 6.6), sharex=True, layout="constrained")
    titles = {
        "right": "A run that is right",
        "lost": "Right until 3 s",
        "coarse": "A run that warns",
    }
    errors = {}
    for ax, (name, title) in zip(axes, titles.items(), strict=True):
        estimated = names[name]
        exact = tc.simulate(
            names["model"],
            estimated.time[-1],
            rest_length=estimated.rest_length[:, 0],
            tolerance=1e-12,
            output_step=estimated.time[1],
            error="none",
        )
        size = np.ptp(exact.nodes[..., 0], axis=1).max()
        error = np.linalg.norm(estimated.nodes - exact.nodes, axis=0).max(axis=0) / size
        errors[title] = {"estimated": estimated.error[1:], "true": error[1:]}
        ylabel = "error of nodes,\npart of the size"
        limit = {"limit": 0.01}
        tc.plot.history(estimated.time[1:], errors[title], ylabel, ax=ax, references=limit)
        ax.set(yscale="log", ylim=(1e-8, 1.0))
        ax.set_title(title, loc="right", pad=8)
        ax.label_outer()
    figure.savefig(folder / "trust.png", dpi=110)
    heights = tc.plot.history(names["lost"].time, names["heights"], "height of node 0, m")
    heights.ax.figure.savefig(folder / "trust_motion.png", dpi=110, bbox_inches="tight")
    plt.close("all")
    return errors


def of_pages(folder):
    """Write a figure that the code of a page draws, for each of some pages."""
    numbers = {
        "few_motors": 1, "identification": 2, "figures": 2, "optimal_motion": 1,
        "deployment": 1, "microcontroller": 1, "stepping": 1, "interop": 1,
    }  # fmt: skip
    for page, number in numbers.items():
        plt.close("all")
        names = {}
        with tempfile.TemporaryDirectory() as written, contextlib.chdir(written):
            for block in blocks(page):
                if block.language != "python" or block.fragment:
                    continue
                if number not in plt.get_fignums():
                    exec(compile(block.code, page, "exec"), names)
        plt.figure(number).savefig(folder / f"{page}.png", dpi=110, bbox_inches="tight")
    plt.close("all")


def without_code(folder):
    """Write the figures of two pages whose code draws none."""
    drawn = tc.plot.structure(tc.prism(), labels=True)
    drawn.ax.figure.savefig(folder / "theory.png", dpi=110, bbox_inches="tight")
    run = tc.load_scene(PROJECT / "examples" / "scenes" / "prism_fault.toml").simulate()
    figure = next(iter(tc.plot.trajectory(run).values())).ax.figure
    figure.savefig(folder / "scenes.png", dpi=110, bbox_inches="tight")
    plt.close("all")


def view_in_browser(folder):
    """Write what a browser shows of a run, if Chromium is there."""
    if CHROMIUM is None:
        return
    ball = tc.library.six_bar_ball()
    rest = tc.prestress(ball, force_density=20.0)
    model = tc.Model(ball, strings=tc.LinearStrings(stiffness=1e3))
    plant = tc.linearize(model, rest, input="rest_length")
    start = plant.to_nodes([0.05] + 23 * [0.0])
    run = tc.simulate(model, 0.5, start, rest_length=plant.rest_length)
    with tempfile.TemporaryDirectory() as written:
        browser = Browser(Path(written) / "profile")
        browser.open(run.to_html(Path(written) / "run.html"))
        browser.picture(folder / "view.png")
        browser.close()


def projects(folder):
    """Write the figures that the files of the page on projects draw."""
    for name in ("mast", "robot", "symbols"):
        plt.close("all")
        with tempfile.TemporaryDirectory() as written, contextlib.chdir(written):
            runpy.run_path(str(PROJECT / "tests" / "first_hours" / f"{name}.py"))
        for number in plt.get_fignums():
            path = folder / f"{name}_{number}.png"
            plt.figure(number).savefig(path, dpi=110, bbox_inches="tight")
    plt.close("all")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    rolling_ball(IMAGES / "rolling_ball.gif")
    first_pages(IMAGES)
    of_pages(IMAGES)
    without_code(IMAGES)
    view_in_browser(IMAGES)
    projects(IMAGES)
    for title, errors in trust(IMAGES).items():
        largest = {name: values.max() for name, values in errors.items()}
        print(f"{title}: error {largest['true']:.2g}, estimated {largest['estimated']:.2g}")
    for image in sorted(IMAGES.iterdir()):
        print(f"{image.name}: {image.stat().st_size / 1e6:.2f} MB")
