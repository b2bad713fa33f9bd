"""
MPC moves a D-bar to a new height
=================================

A D-bar has six bars from two tips to a ring of strings. A string between the tips pulls them
together. MPC commands force densities, and winches hold rest lengths. The structure starts
disturbed and follows a smooth path of equilibria to a new height.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

# %%
# D-bars with bars of 1 m and any height are in balance with the same force densities. Only the rest
# lengths differ.

START, END = 1.6, 1.3  # m


def of_height(height):
    """Return the D-bar with bars of 1 m and this height, m."""
    return tc.library.d_bar_3d(radius=np.sqrt(1 - height**2 / 4), height=height)


d_bar = of_height(START)
model = tc.Model(d_bar, strings=tc.LinearStrings(stiffness=100.0))

# %%
# The path: 1.6 m to 1.3 m in two seconds, without a jump in speed.

time = np.linspace(0.0, 2.0, 41)
share = time / time[-1]
heights = START + (END - START) * (10 * share**3 - 15 * share**4 + 6 * share**5)
path = tc.Reference(time, np.stack([of_height(h).nodes for h in heights], axis=-1))

# %%
# The controller is designed about the target, where it must be exact.

target = of_height(END)
rest = tc.prestress(target, force_density=20.0)
plant = tc.linearize(model, rest)
mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, reference=path)

# %%
# A disturbed start, and winches with limits.

start_plant = tc.linearize(model, tc.prestress(d_bar, force_density=20.0))
q = 0.01 * np.random.default_rng(0).normal(size=start_plant.degrees_of_freedom)
start = start_plant.to_nodes(q)
wound = tc.to_rest_length(model, start, rest.force_density).rest_length
run = tc.simulate(
    model,
    duration=4.0,
    nodes=start,
    controller=mpc,
    winches=tc.Winches(rate=0.5, shortest=0.1),
    rest_length=wound,
    step=1e-3,
)
print(run.summary())

# %%
# The shape at the end, over that at the start.

drawing = tc.plot.structure(d_bar, faint=True)
tc.plot.structure(run, ax=drawing.ax)

# %%
# The displacement of the nodes, force densities and rest lengths.

height = np.linalg.norm(run.nodes[:, 3] - run.nodes[:, 4], axis=0)
height_error = height[-1] - END
print(f"final height error {1e3 * height_error:+.3f} mm")
print(f"smallest γ {run.force_density.min():.2f} N/m")
print(f"largest winch rate {np.abs(run.control.winch_rate).max():.3f} m/s")
tc.plot.trajectory(run)

# %%
# How far to trust it: momentum and bar lengths should not change at all.

tc.plot.health(run)

if __name__ == "__main__":
    plt.show()
