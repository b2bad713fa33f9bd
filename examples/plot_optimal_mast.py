"""
Deployment of a mast at least work
==================================

A mast with a load on its top rises from half its height in 0.7 s. It has two winches: one winds the
three strings of the lid, the other the three verticals. The motion of least work is compared with
the path through equilibria, played in the same time.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import trapezoid

import tenscontrol as tc

DURATION, FOLDED, HEIGHT = 0.7, 0.5, 1.0  # s, m, m
STIFFNESS, RATE = 500.0, 1.5  # N/m, m/s

# %%
# The feet are fixed, and each top node carries 0.5 kg. Both shapes are equilibria under weight.

feet, top = [3, 4, 5], [0, 1, 2]
mast = replace(tc.prism(), fixed=feet, point_mass=np.repeat([0.5, 0.0], 3))
model = tc.Model(mast, tc.LinearStrings(STIFFNESS, damping=5.0), gravity=9.81)


def at_height(height, least, **arguments):
    """Return the equilibrium whose top is so high, m, with strings of at least so many N/m."""
    lid = tc.Height(height, top=top, bottom=feet)
    return tc.shape_target(model, lid, prestress="least", min_force_density=least, **arguments)


raised = at_height(HEIGHT, 60.0)
winches = {"lid": ["top"], "verticals": ["vertical"]}
plant = tc.linearize(model, raised.prestress, input="rest_length", actuated=winches)
folded = at_height(FOLDED, 20.0, plant=plant)

# %%
# The plan of least work, and the path through equilibria.

motion = tc.optimal_motion(
    model, folded, raised, plant=plant, minimize="energy", duration=DURATION,
    winches=tc.Winches(rate=RATE), min_force_density=5.0, intervals=16, tolerance=2e-3,
)  # fmt: skip
path = tc.shape_path(model, folded, raised, plant=plant, duration=DURATION, step=0.01)
print(motion.summary())

# %%
# Both are played, and winches stay as they are afterwards. A winch winds against the elastic pull
# of its strings. Its work counts where it gives power; what it takes back is lost.

LATER = 1.4  # s
profiles = {"least work": motion.profile, "equilibria": tc.Profile(path.time, path.rest_length)}
runs = {
    name: tc.simulate(model, LATER, folded.nodes, rest_length=profile, output_step=1e-3)
    for name, profile in profiles.items()
}


def power_given(run):
    """Return what both winches give, W, shape (T,)."""
    shapes = np.moveaxis(run.nodes, 2, 0)
    stretch = np.column_stack([mast.string_length(N) for N in shapes]) - run.rest_length
    rate = np.gradient(run.rest_length, run.time, axis=1)
    power = -STIFFNESS * np.maximum(stretch, 0.0) * rate
    by_winch = [power[mast.strings_in(group)].sum(axis=0) for group in ("top", "vertical")]
    return np.maximum(by_winch, 0.0).sum(axis=0)


given = {name: power_given(run) for name, run in runs.items()}
work = {name: float(trapezoid(given[name], run.time)) for name, run in runs.items()}
print({name: f"{joule:.1f} J" for name, joule in work.items()})

# %%
# The mast folded, in grey, and raised. The plan needs a quarter less work and ends at rest. After
# the path through equilibria the top swings by centimetres.

figure = plt.figure(figsize=(7.0, 9.0), layout="constrained")
grid = figure.add_gridspec(4, 1, height_ratios=(2.2, 1.0, 1.0, 1.0))
ax = figure.add_subplot(grid[0], projection="3d")
tc.plot.structure(mast, folded.nodes, ax=ax, faint=True)
tc.plot.structure(mast, raised.nodes, ax=ax)
time = np.linspace(0.0, LATER, 701)
wound = {name: mast.strings_in(group)[0] for name, (group,) in winches.items()}
planned = motion.profile.at(np.minimum(time, DURATION))
curves = {
    "top, m": {name: run.nodes[2, top].mean(axis=0) for name, run in runs.items()},
    "power, W": given,
}
for row, (label, values) in enumerate(curves.items()):
    at_times = {name: np.interp(time, runs[name].time, value) for name, value in values.items()}
    panel = figure.add_subplot(grid[row + 1])
    tc.plot.history(time, at_times, label, ax=panel, references={} if row else {"goal": HEIGHT})
tc.plot.history(
    time,
    {name: planned[string] for name, string in wound.items()},
    "planned rest length, m",
    ax=figure.add_subplot(grid[3]),
)

if __name__ == "__main__":
    plt.show()
