"""
A prism moves to a new height
=============================

MPC computes force densities, winches hold rest lengths. The prism starts
disturbed and follows a smooth path through equilibria to a new height.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

# %%
# Prisms of one bar length and any height are in balance with the same force
# densities; only the rest lengths differ.

prism = tc.prism(height=1.0)
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
bar_length = prism.bar_length[0]


def of_height(height):
    """Return the prism with the same bars and this height, m."""
    return tc.prism(radius=tc.structure.prism_radius(bar_length, height), height=height)


# %%
# The path: 1 m to 0.85 m in two seconds, without a jump in speed.

time = np.linspace(0.0, 2.0, 41)
share = time / time[-1]
heights = 1.0 - 0.15 * (10 * share**3 - 15 * share**4 + 6 * share**5)
path = tc.Reference(time, np.stack([of_height(h).nodes for h in heights], axis=-1))

# %%
# The controller is designed about the target, where it must be exact.

target = of_height(0.85)
rest = tc.prestress(target, force_density=17.320508)
plant = tc.linearize(model, rest)
mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, reference=path)

# %%
# A disturbed start, and winches with limits.

start_plant = tc.linearize(model, tc.prestress(prism, force_density=17.320508))
q = 0.003 * np.random.default_rng(0).normal(size=9)
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
# What happened.

height = run.nodes[2, :3].mean(axis=0) - run.nodes[2, 3:].mean(axis=0)
height_error = height[-1] - 0.85
print(f"final height error {1e3 * height_error:+.3f} mm")
print(f"smallest γ {run.force_density.min():.2f} N/m")
print(f"largest winch rate {np.abs(run.control.winch_rate).max():.3f} m/s")
tc.plot.trajectory(run)

# %%
# How far to trust it: momentum and bar lengths should not change at all.

tc.plot.health(run)

if __name__ == "__main__":
    plt.show()
