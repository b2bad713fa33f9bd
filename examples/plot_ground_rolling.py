"""
A ball rolls by winding its strings
===================================

A six-bar ball stands on three nodes. Winches wind its strings until its centre of mass has passed
an edge of this triangle. The ball tips over onto the next triangle, and the winches go back. In
this way it rolls in a commanded direction, on flat ground and up a slope of 5°.
"""

import base64
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

REST_LENGTH, SAMPLE, FACE = 0.55, 0.05, [0, 4, 8]  # m, s; the nodes it stands on at the start
SLOPES = {"flat": 0.0, "slope of 5°": 5.0}

# %%
# Bars of 1 m and 0.5 kg, strings of 1000 N/m. Winches wind 0.2 m in a second, between 0.35 m and
# 0.8 m.

ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
winches = tc.Winches(rate=0.2, shortest=0.35, longest=0.8, ramp=True)


def on_slope(degrees):
    """Return the model on ground that rises along x, and the direction uphill."""
    angle = np.radians(degrees)
    normal = [-np.sin(angle), 0.0, np.cos(angle)]
    ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.02, normal=normal)
    strings = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    model = tc.Model(ball, strings=strings, gravity=9.81, ground=ground)
    return model, [np.cos(angle), 0.0, np.sin(angle)]


# %%
# One step on paper: from equilibrium to equilibrium, rest lengths change by the gradient of the
# distance by which the centre of mass is beyond the edge.

model, uphill = on_slope(5.0)
path = tc.shape.tipping_path(
    model, REST_LENGTH, FACE, uphill, nodes=tc.plant.set_down(model, FACE), winches=winches
)
print(path)

# %%
# Five steps on the nonlinear plant. The gait sees which nodes touch the ground, and goes one
# equilibrium further in each sample.

runs, gaits = {}, {}
for name, slope in SLOPES.items():
    model, direction = on_slope(slope)
    gaits[name] = gait = tc.shape.RollingGait(
        model, REST_LENGTH, direction, SAMPLE, winches=winches, steps=5
    )
    runs[name] = run = tc.simulate(
        model,
        15.0,
        nodes=tc.plant.set_down(model, FACE),
        controller=gait,
        winches=winches,
        rest_length=REST_LENGTH,
        output_step=SAMPLE,
    )
    moved = direction @ (run.nodes[:, :, -1] - run.nodes[:, :, 0]).mean(axis=1)
    print(
        f"{name}: {len(gait.made)} steps in {gait.made[-1].time:.1f} s, {moved:.2f} m; a command "
        f"takes {run.control.computing_time.max() / SAMPLE:.2f} sample times at most"
    )

# %%
# The ball on the slope: at the start, and just before its first step.

run = runs["slope of 5°"]
drawing = tc.plot.structure(run, time=0.0, legend=False)
before = np.searchsorted(run.time, gaits["slope of 5°"].made[0].time)
drawing = tc.plot.structure(run, time=run.time[before])
drawing.ax.view_init(6.0, -80.0)

# %%
# Where the centre of mass went, seen from above: each dot is where the ball tipped.

figure, axes = plt.subplots(2, 1, figsize=(6.4, 5.6), layout="constrained")
for name, run in runs.items():
    centre = run.nodes.mean(axis=1)
    at = np.searchsorted(run.time, [step.time for step in gaits[name].made])
    (line,) = axes[0].plot(centre[0], centre[1], label=name)
    axes[0].plot(centre[0, at], centre[1, at], "o", color=line.get_color())
axes[0].set(xlabel="x, m", ylabel="y, m", aspect="equal")
axes[0].legend(frameon=False)
run = runs["slope of 5°"]
tc.plot.history(
    run.control.time, {"rest lengths, slope": run.control.applied}, "rest length, m", ax=axes[1]
)

# %%
# Up the slope, at twice the speed.


class Animation:
    """A GIF as this page shows it."""

    def __init__(self, run):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "ball.gif"
            tc.plot.animate(run, path, duration=7.5, fps=8, dpi=60, view=(6.0, -80.0))
            self.picture = path.read_bytes()

    def _repr_html_(self):
        code = base64.b64encode(self.picture).decode()
        return f'<img alt="The ball rolls up the slope." src="data:image/gif;base64,{code}">'


Animation(run)
