"""
NMPC height and twist morphing with winches
===========================================

Nonlinear MPC lowers a prism of twelve strings from 1.0 m to 0.7 m, twists it by 20° on the way, and
brings it back. Winches wind its strings, within their speed and range. The controller is designed
on massless strings; those of the simulated prism have 5 % of the mass of the bars.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]
STIFFNESS, DAMPING, SAMPLE = 1000.0, 0.6, 0.02  # N/m, N s/m, s
RATE, LARGEST_TENSION, REST = 0.25, 45.0, 0.6  # m/s, N, s

# %%
# Nine strings hold a prism at one twist only. With a second set of strings from top
# to bottom the twist is free.

prism = tc.prism(diagonals=True)
model = tc.Model(prism, strings=tc.LinearStrings(STIFFNESS, damping=DAMPING))


def shape(height, degrees):
    """Return the equilibrium of this height and twist."""
    return tc.shape_target(
        model,
        [tc.Height(height, TOP, BOTTOM), tc.Twist(np.radians(degrees), TOP, BOTTOM)],
        force_density=17.32,  # N/m, the mean of the top strings
        min_force_density=2.0,
        symmetry=tc.RotationalSymmetry([TOP, BOTTOM]),
    )


start, goal = shape(1.0, -35.0), shape(0.7, -55.0)
drawing = tc.plot.structure(start, faint=True)
tc.plot.structure(goal, ax=drawing.ax)

# %%
# The path, as fast as the winches allow. A winch winds through each sample at constant
# speed, here in 10 pieces.

winches = tc.Winches(RATE, shortest=0.4, longest=1.3, substeps=10)
path = tc.shape_path(model, start, goal, winches=winches, step=SAMPLE, min_force_density=2.0)
there = path.reference()
reference = there.then(there.reversed(), pause=REST)
print(f"there in {path.time[-1]:.2f} s, clearance of the bars {path.clearance:.3f} m")

# %%
# One linear plant is not good for all of the way. Nonlinear MPC linearizes along its own
# plan; it is designed half way.

(half,) = path.plants(1, input="rest_length")
nmpc = tc.NMPC(
    half,
    horizon=8,
    sample_time=SAMPLE,
    reference=reference,
    winches=winches,
    min_force_density=2.0,
    max_tension=LARGEST_TENSION,
)

# %%
# The plant: each string in two segments with a mass between them.

mass = 0.05 * prism.bar_mass.sum() / len(prism.strings)
massive = tc.subdivide(start.prestress.structure, 2, string_mass=mass)
count = tc.structure.segment_counts(massive)
plant = tc.Model(massive, strings=tc.LinearStrings(STIFFNESS * count, damping=DAMPING * count))
run = tc.simulate(
    plant,
    reference.time[-1] + REST,
    controller=nmpc,
    winches=winches,
    rest_length=path.rest_length[:, 0],
    step=1e-3,
    output_step=SAMPLE,
)

# %%
# Height and twist of a motion.


def height(nodes):
    """Return the distance of the centres of top and bottom, m, at each time."""
    return np.linalg.norm(nodes[:, TOP].mean(axis=1) - nodes[:, BOTTOM].mean(axis=1), axis=0)


def twist(nodes):
    """Return the turn of the top against the bottom about the vertical, degrees, at each time."""
    top, bottom = (
        nodes[:2, part] - nodes[:2, part].mean(axis=1)[:, None] for part in (TOP, BOTTOM)
    )
    across = (bottom[0] * top[1] - bottom[1] * top[0]).sum(axis=0)
    return np.degrees(np.arctan2(across, (bottom * top).sum(axis=(0, 1))))


at_goal = int(np.searchsorted(run.time, path.time[-1] + REST)) - 1
errors = {
    name: (1e3 * (height(run.nodes)[k] - h), twist(run.nodes)[k] - degrees)
    for name, k, h, degrees in (("goal", at_goal, 0.7, -55.0), ("start", -1, 1.0, -35.0))
}
for name, (off, turned) in errors.items():
    print(f"at the {name}: height off by {off:.4f} mm, twist by {turned:.5f}°")
lengths = np.linalg.norm(
    run.nodes[:, massive.strings[:, 1]] - run.nodes[:, massive.strings[:, 0]], axis=0
)
tension = run.force_density * lengths
rates = np.abs(run.control.winch_rate)
at_rate = (rates.max(axis=0) > 0.99 * RATE).mean()
print(f"smallest γ of a string {run.force_density.min() / 2:.2f} N/m, largest tension "
      f"{tension.max():.1f} N of {LARGEST_TENSION:g} N")  # fmt: skip
print(f"fastest winch {rates.max():.4f} m/s; one at its limit in {100 * at_rate:.0f} % of samples")

# %%
# Shapes, height and twist against their reference, winches (positive where they pay out) and force
# densities.

figure = plt.figure(figsize=(7.5, 10.0), layout="constrained")
grid = figure.add_gridspec(5, 3, height_ratios=(1.6, 1.0, 1.0, 1.0, 1.0))
for column, k in enumerate((0, at_goal // 2, at_goal)):
    ax = figure.add_subplot(grid[0, column], projection="3d")
    tc.plot.structure(massive, run.nodes[:, :, k], ax=ax, legend=False)
    ax.set_axis_off()
    ax.set_title(f"{run.time[k]:.2f} s")
for row, (what, label) in enumerate(((height, "height, m"), (twist, "twist, °")), start=1):
    wanted = np.interp(run.time, reference.time, what(reference.nodes))
    curves = {"plant": what(run.nodes), "reference": wanted}
    tc.plot.history(run.time, curves, label, ax=figure.add_subplot(grid[row, :]))
groups = {name: prism.strings_in(name) for name in ("top", "vertical", "diagonal")}
tc.plot.history(
    run.control.time,
    {name: run.control.winch_rate[strings] for name, strings in groups.items()},
    "winch, m/s",
    ax=figure.add_subplot(grid[3, :]),
    references={"limit out": RATE, "limit in": -RATE},
)
first = np.flatnonzero(np.diff(massive.string_parent, prepend=-1))  # first segment of each string
tc.plot.history(
    run.time,
    {name: run.force_density[first[strings]] / 2 for name, strings in groups.items()},
    "γ, N/m",
    ax=figure.add_subplot(grid[4, :]),
    references={"least asked for": 2.0},
)

if __name__ == "__main__":
    plt.show()
