"""
What can a log of a ball tell?
==============================

A six-bar ball drops onto the ground and bounces. Encoders read the lengths of its 24 strings, and
a sensor on each bar its direction, 50 times a second. Which stiffnesses, masses and friction does
the ball have? And which of them can no such log ever tell?
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

ball = tc.library.six_bar_ball()
ground = tc.Ground(2e3, damping=0.3, friction=0.5)
start = ball.nodes - [[0.0], [0.0], [ball.nodes[2].min() - 0.02]]  # 2 cm above the ground
push = np.zeros(ball.nodes.shape)
push[0] = 0.5  # m/s
rest = 0.95 * ball.string_length()
deep = tc.HealthLimits(penetration=None)  # the ground is soft


def built(stiffness, bar_mass, friction):
    """Return a ball on the ground."""
    return tc.Model(
        replace(ball, bar_mass=bar_mass),
        strings=tc.LinearStrings(stiffness, damping=2.0),
        gravity=9.81,
        ground=replace(ground, friction=friction),
    )


# %%
# A noisy log
# -----------
#
# In place of a real ball: one whose strings and bars are off by about 20 % from what its builder
# believes. Lengths are read to 1 mm, directions to 0.005.

random = np.random.default_rng(8)
stiffness = 800.0 * np.exp(0.2 * random.normal(size=24))
bar_mass = ball.bar_mass * np.append(1.0, np.exp(0.2 * random.normal(size=5)))
robot = built(stiffness, bar_mass, 0.4)
run = tc.simulate(
    robot, 1.0, start, push, rest_length=rest, tolerance=1e-8, output_step=0.02, limits=deep
)
sensors = tc.Sensors(structure=ball, string_length=1e-3, bar_direction=5e-3)
log = tc.Log.of_run(run, sensors, np.arange(1, 51) * 0.02, seed=0)

# %%
# What it cannot tell
# -------------------
#
# Before any fit: were all strings, bars and the ground twice as stiff, heavy and damped, the ball
# would move alike. No length or direction tells that scale.

believed = built(800.0, ball.bar_mass, 0.5)
unknown = ["stiffness", "damping", "bar_mass", "ground.stiffness", "ground.friction"]
same = {"damping": "all"}
before = tc.identifiable(believed, log, unknown, groups=same)
print(before.table().splitlines()[-1])

figure, ax = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
ax.semilogy(before.singular, "o", markersize=4)
ax.axhline(1.0, color="0.4", linewidth=0.8)
ax.annotate("not told", (0.02, 0.9), xycoords=("axes fraction", "data"), va="top")
ax.set(xlabel="direction", ylabel="what the log tells,\npriors' deviations")

# %%
# With one bar on a scale
# -----------------------
#
# One mass that is known gives the scale: bar 0 was weighed.

found = tc.fit(believed, log, unknown, known={"bar_mass": [0]}, groups=same)
print(found)
ratio = found.parameters["stiffness"] / stiffness

# sphinx_gallery_thumbnail_number = 2
figure = tc.plot.intervals(found)

# %%
# Is it right?
# ------------
#
# Another push, which the fit has not seen: the residuals are those of the noise.

other = tc.simulate(
    robot, 1.0, start, -push, rest_length=rest, tolerance=1e-8, output_step=0.02, limits=deep
)
check = found.validate(tc.Log.of_run(other, sensors, np.arange(1, 51) * 0.02, seed=1))
print(check)

if __name__ == "__main__":
    plt.show()
