"""
Rest lengths, wind and an earthquake over time
==============================================

Rest lengths, loads and the motion of supports can be given over time: as a table of values, or as
any smooth function. A class-2 tower of two stages stands on three fixed nodes. Winches shorten its
strings within a second. Then wind pushes its top, and the ground shakes.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

tower = replace(tc.library.class2_tower(), fixed=[0, 1, 2])
strings = tc.LinearStrings(stiffness=1000.0, damping=10.0)
model = tc.Model(tower, strings=strings, external_force=True)
rest = tc.prestress(tower, min_force_density=60.0)
length = tc.to_rest_length(model, tower.nodes, rest.force_density).rest_length

# %%
# The strings that go up are wound in by a tenth, from 0.5 s to 1.5 s, along a cubic spline.

rise = np.abs(tower.nodes[2, tower.strings[:, 1]] - tower.nodes[2, tower.strings[:, 0]])
up = rise > 1e-9
wound = tc.Profile([0.5, 1.5], np.column_stack([length, np.where(up, 0.9, 1.0) * length]), "cubic")

# %%
# A gust of 2 Hz pushes the top along x from 2 s on; straight lines lead in and out of it.

top = np.isclose(tower.nodes[2], tower.nodes[2].max())
strength = tc.Profile([2.0, 2.5, 3.5, 4.0], [0.0, 1.0, 1.0, 0.0])
times = np.linspace(2.0, 4.0, 81)
values = np.zeros((3, top.size, times.size))
values[0, top] = 2.0 * strength.at(times) * np.sin(4 * np.pi * (times - 2.0))
gust = tc.Profile(times, values, "cubic")


# %%
# The ground moves along y by up to 2 cm at 3 Hz, in waves that come and go around 5.5 s.
def ground(t):
    """Return the displacement of the three supports, m."""
    wave = 0.02 * np.exp(-(((t - 5.5) / 0.4) ** 2)) * np.sin(6 * np.pi * t)
    return np.tile([[0.0], [wave], [0.0]], 3)


run = tc.simulate(
    model, 7.0, rest_length=wound, external_force=gust, support_motion=ground, tolerance=1e-9
)
print(run.summary())
height = run.nodes[2, top].mean(axis=0)
sway = run.nodes[:2, top].mean(axis=1)
print(f"the top comes down by {height[0] - height[-1]:.3f} m and sways by {np.ptp(sway[1]):.3f} m")

# %%
# The tower at the largest sway, over its shape at the start.

drawing = tc.plot.structure(tower, faint=True)
tc.plot.structure(run, time=run.time[np.abs(sway[0] - sway[0, 0]).argmax()], ax=drawing.ax)

# %%
# What is given, and the motion of the top.

figure, axes = plt.subplots(3, 1, figsize=(7.0, 7.0), sharex=True, layout="constrained")
tc.plot.history(
    run.time,
    {"strings that go up": run.rest_length[up].mean(axis=0),
     "others": run.rest_length[~up].mean(axis=0)},
    ylabel="mean rest length, m", ax=axes[0],
)  # fmt: skip
tc.plot.history(
    run.time, {"x of the top": sway[0] - sway[0, 0], "y of the top": sway[1] - sway[1, 0],
               "y of the ground": run.nodes[1, 0] - tower.nodes[1, 0]},
    ylabel="displacement, m", ax=axes[1],
)  # fmt: skip
tc.plot.history(run.time, {"top": height}, ylabel="height, m", ax=axes[2])

if __name__ == "__main__":
    plt.show()
