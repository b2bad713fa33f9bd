"""
Find a shape and a path to it
=============================

You ask for a height and a twist. The toolbox finds an equilibrium with exact bar lengths, or the
nearest one and by how much it misses. Then it finds a path of equilibria to that shape, as fast as
the winches allow.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

TOP, BOTTOM = [0, 1, 2], [3, 4, 5]

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
rest = tc.prestress(prism, force_density=10.0)  # N/m in the top strings; 17.32 in the vertical

# %%
# A regular prism of nine strings rests at one twist only, -30° for a left-handed
# one. With a threefold symmetry any other twist is refused. The error has the nearest
# shape.

twist = tc.Twist(np.radians(-25.0), TOP, BOTTOM)
try:
    tc.shape_target(model, twist, force_density=10.0, symmetry=tc.RotationalSymmetry([TOP, BOTTOM]))
except tc.shape.ShapeError as error:
    print(error)
    missed = np.degrees(error.nearest.missed[0].missed)

# %%
# Without symmetry there is a solution: the top tilts, and strings of one group differ in force.

goal = tc.shape_target(
    model,
    [tc.Height(0.85, TOP, BOTTOM), twist],
    force_density=10.0,  # N/m, the mean of the top strings
    min_force_density=2.0,
)
print(goal)
print("γ, N/m:", goal.force_density.round(2))
drawing = tc.plot.structure(prism, faint=True)
tc.plot.structure(goal, ax=drawing.ax)

# %%
# The path. One winch runs at its limit of 0.1 m/s all the time but for the ramps.

path = tc.shape_path(
    model, rest, goal, winches=tc.Winches(rate=0.1), min_force_density=2.0, step=0.02
)
print(path)
print(f"largest unbalanced force {path.residual:.1e} N, bars off by {path.bar_length_error:.1e}")
print(f"smallest γ {path.force_density.min():.2f} N/m, clearance {path.clearance:.3f} m")

figure = plt.figure(figsize=(7.5, 8.5), layout="constrained")
grid = figure.add_gridspec(3, 3, height_ratios=(1.3, 1.0, 1.0))
for column, share in enumerate((0.0, 0.5, 1.0)):
    k = round(share * (len(path.time) - 1))
    ax = figure.add_subplot(grid[0, column], projection="3d")
    tc.plot.structure(prism, ax=ax, faint=True, legend=False)
    tc.plot.structure(prism, path.nodes[:, :, k], ax=ax, legend=False)
    ax.set_axis_off()
    ax.set_title(f"{path.time[k]:.2f} s")
groups = {name: prism.strings_in(name) for name in ("top", "bottom", "vertical")}
tc.plot.history(
    path.time,
    {name: path.force_density[strings] for name, strings in groups.items()},
    "γ, N/m",
    ax=figure.add_subplot(grid[1, :]),
)
tc.plot.history(
    path.time,
    {name: path.rest_length_rate[strings] for name, strings in groups.items()},
    "winding, m/s",
    ax=figure.add_subplot(grid[2, :]),
    references={"limit": 0.1, "limit down": -0.1},
)

# %%
# MPC follows it: γ from the controller, rest lengths by the winches.

plant = tc.linearize(model, goal.prestress)
mpc = tc.MPC(
    plant, horizon=20, sample_time=0.02, max_force_density=90.0, reference=path.reference()
)
run = tc.simulate(
    model,
    duration=path.time[-1] + 1.0,
    controller=mpc,
    winches=tc.Winches(rate=0.5),
    rest_length=path.rest_length[:, 0],
    step=1e-3,
    output_step=0.02,
)
z = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
left = np.linalg.norm(plant.to_nodes(z[: plant.degrees_of_freedom]) - goal.nodes, axis=0).max()
print(f"farthest node {1e3 * left:.3f} mm from its goal at the end")

if __name__ == "__main__":
    plt.show()
