"""The animated GIF and the film: frames, time, size, and what is refused."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import tenscontrol as tc
from tenscontrol.plot.animation import _sampled


def frames(path):
    """Return the pictures, shape (count, height, width, 3), and the time each is shown, ms."""
    pictures, shown = [], []
    with Image.open(path) as gif:
        assert gif.format == "GIF"
        assert gif.info["loop"] == 0
        for i in range(gif.n_frames):
            gif.seek(i)
            pictures.append(np.asarray(gif.convert("RGB")))
            shown.append(gif.info["duration"])
    return np.array(pictures), shown


def test_forty_frames_stay_small(prism, slack_run, tmp_path):
    lower = tc.prism(height=0.8, radius=tc.structure.prism_radius(prism.bar_length[0], 0.8))
    path = tc.plot.animate(
        slack_run, tmp_path / "run.gif", fps=20, duration=2.0, target=lower.nodes
    )
    assert path == tmp_path / "run.gif"
    pictures, shown = frames(path)
    assert pictures.shape == (40, 450, 500, 3)
    assert set(shown) == {50}
    assert path.stat().st_size < 0.75e6


def test_plays_in_real_time_unless_told_otherwise(slack_run, tmp_path):
    _, shown = frames(tc.plot.animate(slack_run, tmp_path / "run.gif", fps=10, dpi=30))
    assert shown == [100] * 4


def test_odd_rates_keep_the_time_on_the_whole(slack_run, tmp_path):
    path = tc.plot.animate(slack_run, tmp_path / "run.gif", fps=30, duration=0.4, dpi=30)
    _, shown = frames(path)
    assert len(shown) == 12
    assert sum(shown) == 400
    assert set(shown) == {30, 40}


def test_paper_is_white_and_the_frame_stands_still(slack_run, tmp_path):
    pictures, _ = frames(tc.plot.animate(slack_run, tmp_path / "run.gif", fps=10, dpi=50))
    assert (pictures[:, -3:, :3] == 255).all()
    assert (pictures[:, -3:, -3:] == 255).all()
    changed = (pictures != pictures[0]).any(axis=(0, 3))
    # The axis of x and its numbers are at the bottom, the legend at the left on top.
    assert not changed[-40:, :].any()
    assert not changed[:30, :80].any()
    assert changed.any()


def test_frames_are_equally_spaced_states_with_the_last_among_them(slack_run):
    times = np.linspace(0, slack_run.time[-1], 7)
    shapes, gammas, _ = _sampled(slack_run, slack_run.nodes, times)
    assert np.array_equal(shapes[:, :, 0], slack_run.nodes[:, :, 0])
    assert np.array_equal(shapes[:, :, -1], slack_run.nodes[:, :, -1])
    assert np.array_equal(gammas[:, -1], slack_run.force_density[:, -1])
    exact = [np.interp(times, slack_run.time, row) for row in slack_run.nodes[1]]
    assert np.allclose(shapes[1], exact, rtol=0, atol=1e-14)


def test_target_is_drawn_faintly(slack_run, tmp_path):
    plain, _ = frames(tc.plot.animate(slack_run, tmp_path / "a.gif", fps=5, dpi=50))
    target, _ = frames(
        tc.plot.animate(
            slack_run, tmp_path / "b.gif", fps=5, dpi=50, target=slack_run.nodes[:, :, -1] * 0.9
        )
    )
    light = [((p[0] > 190).all(axis=2) & (p[0] < 225).all(axis=2)).sum() for p in (plain, target)]
    assert light[1] > light[0] + 300


def test_a_single_state_is_a_picture(slack_run, tmp_path):
    first = replace(
        slack_run,
        time=slack_run.time[:1],
        nodes=slack_run.nodes[:, :, :1],
        velocities=slack_run.velocities[:, :, :1],
    )
    vars(first)["force_density"] = slack_run.force_density[:, :1]
    pictures, _ = frames(tc.plot.animate(first, tmp_path / "one.gif", dpi=30))
    assert len(pictures) == 1


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="MP4 files are written by ffmpeg")
def test_a_film_has_the_frames_of_the_gif(slack_run, tmp_path):
    gif, _ = frames(tc.plot.animate(slack_run, tmp_path / "run.gif", fps=10, dpi=33))
    path = tc.plot.animate(slack_run, tmp_path / "run.mp4", fps=10, dpi=33)
    raw = subprocess.run(
        ["ffmpeg", "-loglevel", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "gray", "-"],
        capture_output=True,
        check=True,
    ).stdout
    even = [side + side % 2 for side in gif.shape[1:3]]  # H.264 has even sizes
    film = np.frombuffer(raw, dtype=np.uint8).reshape(len(gif), *even)
    film = film[:, : gif.shape[1], : gif.shape[2]].astype(float)
    assert np.abs(film - gif.mean(axis=3)).mean() < 4.0
    assert (film[0] != film[-1]).any()


def test_a_film_without_ffmpeg_says_what_to_install(slack_run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"program ffmpeg.*install it.*ends in \.gif"):
        tc.plot.animate(slack_run, tmp_path / "run.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_film_that_ffmpeg_refuses_is_an_error_with_its_reason(slack_run, tmp_path, monkeypatch):
    fake = tmp_path / "ffmpeg"
    fake.write_text("#!/bin/sh\necho 'Unknown encoder libx264' >&2\nexit 1\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(OSError, match=r"could not write .*Unknown encoder libx264; or write a"):
        tc.plot.animate(slack_run, tmp_path / "run.mp4", dpi=30)
    assert list(tmp_path.iterdir()) == [fake]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            {"path": "run.avi"},
            ValueError,
            "path is 'run.avi', expected .* in .gif, .mp4",
        ),
        ({"path": 3}, TypeError, "path is 3, expected a path"),
        ({"path": None}, TypeError, "path is None, expected a path"),
        ({"path": "a\0.gif"}, ValueError, r"path is 'a\\x00.gif', expected a name that a file can"),
        ({"path": "not/there/run.gif"}, FileNotFoundError, "its folder is not there"),
        ({"fps": 0}, ValueError, "fps is 0, expected a positive"),
        ({"fps": 60}, ValueError, "fps is 60, expected at least 0.01 and at most 50"),
        ({"fps": 1e-3}, ValueError, "fps is 0.001, expected at least 0.01"),
        ({"duration": 1e12}, ValueError, r"duration is 1e\+12 s, which .* expected at most 4e\+09"),
        ({"duration": -1.0}, ValueError, "duration is -1.0"),
        ({"target": np.zeros((3, 5))}, ValueError, r"target has shape \(3, 5\), expected \(3, 6\)"),
        ({"target": np.full((3, 6), np.inf)}, ValueError, r"target\[0, 0\] is inf"),
        ({"view": (0, 1, 2)}, ValueError, r"view has shape \(3,\)"),
        ({"dpi": 5}, ValueError, "dpi is 5"),
        ({"dpi": 10**400}, ValueError, "dpi is 1000"),
        ({"size": 3}, TypeError, "size"),
    ],
)
def test_wrong_arguments_are_named_and_nothing_is_written(
    slack_run, tmp_path, monkeypatch, arguments, error, message
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        tc.plot.animate(slack_run, **({"path": "run.gif"} | arguments))
    assert list(tmp_path.iterdir()) == []


def test_motion_that_is_not_finite_is_refused(slack_run, tmp_path):
    nodes = slack_run.nodes.copy()
    nodes[1, 2, 3] = np.nan
    with pytest.raises(ValueError, match=r"run.nodes\[1, 2, 3\] is nan"):
        tc.plot.animate(replace(slack_run, nodes=nodes), tmp_path / "run.gif")
    assert list(tmp_path.iterdir()) == []


def test_leaves_no_figure_behind(slack_run, tmp_path):
    import matplotlib.pyplot as plt

    tc.plot.animate(slack_run, tmp_path / "run.gif", fps=5, dpi=30)
    assert plt.get_fignums() == []
