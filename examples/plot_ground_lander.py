"""
A lander: how stiff should the strings be?
==========================================

A six-bar ball carries a payload at its centre, held by twelve strings. It falls from 1, 3 and 10 m.
With stiff strings the payload stops hard, with soft ones it strikes the ground. For each height one
stiffness between the two gives the least deceleration. Only nodes touch the ground: bars may pass
through one another.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import tenscontrol as tc

LENGTH, BAR, PAYLOAD = 1.0, 0.5, 5.0  # m, kg, kg
GRAVITY, PRESTRESS = 9.81, 10.0  # m/s², N/m
HEIGHTS = (1.0, 3.0, 10.0)  # m
STIFFNESS = np.geomspace(500.0, 5e4, 8)  # N/m
RATIO = 0.5  # force density of the strings of the payload over that of the shell

# %%
# The lander
# ----------
#
# The strings of the payload draw the ball together. The bars of a pair are nearer to each other
# than in the ball alone, so that the forces balance. It falls on a triangle of strings.

ball = tc.library.six_bar_ball(bar_length=LENGTH, bar_mass=BAR)
nodes = np.where(np.isclose(np.abs(ball.nodes), LENGTH / 4), 4 / (4 + RATIO), 1.0) * ball.nodes
face = nodes[:, [8, 4, 0]].sum(axis=1)
down = Rotation.align_vectors([[0.0, 0.0, -1.0]], [face])[0].as_matrix()
lander = tc.Structure(
    np.column_stack([down @ nodes, np.zeros(3)]),
    bars=ball.bars,
    strings=[*ball.strings, *((node, 12) for node in range(12))],
    bar_mass=BAR,
    string_node_mass=[PAYLOAD],
    string_groups=["shell"] * 24 + ["payload"] * 12,
)
tc.plot.structure(lander)
rest = tc.prestress(lander, min_force_density=PRESTRESS)
ground = tc.Ground(stiffness=1e5, damping=0.1, friction=0.5, height=lander.nodes[2].min())


def drop(height, stiffness, **accuracy):
    """Return the run from the moment of touching, and the upward acceleration of the payload."""
    strings = tc.LinearStrings(stiffness, damping=0.02 * np.sqrt(stiffness))
    model = tc.Model(lander, strings=strings, gravity=GRAVITY, ground=ground)
    wound = tc.to_rest_length(model, lander.nodes, rest.force_density).rest_length
    speeds = np.zeros_like(lander.nodes)
    speeds[2] = -np.sqrt(2 * GRAVITY * height)
    run = tc.simulate(
        model, 0.15, velocities=speeds, rest_length=wound, output_step=5e-4,
        limits=tc.HealthLimits(crossings=None), **accuracy,
    )  # fmt: skip
    return run, np.gradient(run.velocities[2, 12], run.time)


peak = {
    height: np.array([drop(height, k, tolerance=1e-7)[1].max() for k in STIFFNESS]) / GRAVITY
    for height in HEIGHTS
}
best = {height: STIFFNESS[values.argmin()] for height, values in peak.items()}
for height in HEIGHTS:
    print(
        f"from {height:g} m: {peak[height].min():.0f} g at k = {best[height]:.3g} N/m, "
        f"{peak[height][0]:.0f} g with the softest strings, {peak[height][-1]:.0f} g with the "
        "stiffest"
    )

# %%
# How far these figures hold: one drop at a thousandth of the tolerance.

run, acceleration = drop(HEIGHTS[-1], best[HEIGHTS[-1]], tolerance=1e-7)
finer = drop(HEIGHTS[-1], best[HEIGHTS[-1]], tolerance=1e-10)[1]
error = abs(acceleration.max() / finer.max() - 1)
print(f"peak of the acceleration off by {error:.0e} of itself")
soft = drop(HEIGHTS[-1], STIFFNESS[0], tolerance=1e-7)[0]
print(f"the axes of bars stay {1e3 * run.health.clearance.distance:.0f} mm apart")
print(f"with the softest strings bars cross {len(soft.health.crossings)} times")

# %%
# The fall from 10 m with the best strings, and the accelerations.

squeezed = run.nodes[2, 12].argmin()
figure = plt.figure(figsize=(8.5, 7.5), layout="constrained")
grid = figure.add_gridspec(2, 2)
for column, (k, title) in enumerate(((0, "touching"), (squeezed, "payload lowest"))):
    ax = figure.add_subplot(grid[0, column], projection="3d")
    tc.plot.structure(lander, run.nodes[:, :, k], ax=ax, legend=False)
    ax.view_init(5, -80)
    ax.set_axis_off()
    ax.set_title(f"{title}, {1e3 * run.time[k]:.0f} ms")
heights = {"payload": run.nodes[2, 12], "lowest node": run.nodes[2, :12].min(axis=0)}
heights = {name: each - ground.height for name, each in heights.items()}
tc.plot.history(run.time, heights, "height above ground, m", ax=figure.add_subplot(grid[1, 0]))
ax = figure.add_subplot(grid[1, 1])
for height, style in zip(HEIGHTS, ("o-", "s--", "^:"), strict=True):
    ax.loglog(STIFFNESS, peak[height], style, label=f"from {height:g} m")
ax.set_xlabel("stiffness of the strings, N/m")
ax.set_ylabel("peak of the payload's acceleration, g")
ax.legend(frameon=False)

if __name__ == "__main__":
    plt.show()
