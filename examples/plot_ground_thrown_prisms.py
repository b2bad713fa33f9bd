"""
A prism is thrown a thousand times: where does it land?
=======================================================

Each throw has a slightly different velocity and spin, and strings of a stiffness known to 20 %.
:func:`tenscontrol.simulate_many` simulates all throws at once. Most prisms land on their feet. A
few topple and come to rest beside the others.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

RUNS, DURATION, STEP = 1000, 1.5, 4e-4  # s
SPEED, SPREAD, SPIN = np.array([1.5, 0.0, 1.0]), 0.02, 0.2  # m/s, m/s, rad/s

prism = tc.prism(radius=0.25, height=0.5, bar_mass=0.5)
rest = tc.prestress(prism, force_density=100.0)
ground = tc.Ground(stiffness=2e4, damping=0.2, friction=0.6, height=prism.nodes[2].min() - 0.05)
model = tc.Model(prism, tc.LinearStrings(1000.0, damping=5.0), gravity=9.81, ground=ground)
lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length

# %%
# The throws
# ----------
#
# Rigid motion stretches no bar: a velocity and a spin about the centre.

rng = np.random.default_rng(0)
speed = SPEED + SPREAD * rng.standard_normal((RUNS, 3))
spin = SPIN * rng.standard_normal((RUNS, 3))
arms = prism.nodes - prism.nodes.mean(axis=1, keepdims=True)
velocities = speed[:, :, None] + np.cross(spin[:, :, None], arms[None], axis=1)
scene = tc.Scene(
    model, DURATION, rest_length=lengths, integration=tc.Integration(step=STEP, output_step=0.01)
)
batch = tc.simulate_many(
    scene, {"velocities": velocities, "stiffness": rng.uniform(800.0, 1200.0, RUNS)},
    # Bounces magnify errors: where many throws end can be told, not where one of them does.
    error="none",
)  # fmt: skip

# %%
# Where they go
# -------------

centre = batch.nodes.mean(axis=2)  # (runs, 3, K)
figure, (side, top) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
side.plot(centre[::10, 0].T, centre[::10, 2].T, color="0.6", linewidth=0.6)
side.set(xlabel="x, m", ylabel="z, m", title="Centre, every tenth throw")
top.scatter(*centre[:, :2, -1].T, s=4)
top.set(xlabel="x, m", ylabel="y, m", title=f"After {DURATION:g} s", aspect="equal")
toppled = centre[:, 2, -1] < 0.16  # standing, the centre is 0.2 m above the ground
print(f"{batch}: {toppled.sum()} toppled")

# %%
# One that stands, and in grey one that toppled.

# sphinx_gallery_thumbnail_number = 2
drawing = tc.plot.structure(prism, batch.nodes[toppled][0][:, :, -1], faint=True)
tc.plot.structure(prism, batch.nodes[~toppled][0][:, :, -1], ax=drawing.ax)

if __name__ == "__main__":
    plt.show()
