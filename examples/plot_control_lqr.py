"""
LQR brings a pushed structure to rest
=====================================

A structure of six bars and eighteen strings, a truncated tetrahedron, is pushed out of its shape.
An LQR brings it back. It is designed twice: with force densities as the input, for cables that
hold a force, and with rest lengths, for winches.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

STIFFNESS, SAMPLE, DURATION = 300.0, 0.02, 5.0  # N/m, s, s

structure = tc.library.truncated_tetrahedron(bar_length=1.0)
rest = tc.prestress(structure, force_density=20.0)
model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))
tc.plot.structure(rest)

# %%
# The two plants differ: held rest lengths make the strings stiff, and all but the
# softest motions fast.

designs = {}
for held in ("force_density", "rest_length"):
    plant = tc.linearize(model, rest, input=held)
    Q, R = tc.energy_weights(plant, by_mode=held == "rest_length")
    designs[held] = plant, tc.LQR(plant, Q, 0.1 * R)

print("input           fastest pole      slowest pole, open loop -> closed loop")
for held, (plant, law) in designs.items():
    open_loop = np.linalg.eigvals(plant.A)
    print(
        f"{held:14s} {np.abs(open_loop).max():7.1f} 1/s   {open_loop.real.max():13.3f} 1/s -> "
        f"{law.poles.real.max():.3f} 1/s"
    )

# %%
# The response to one push, with what the actuators hold between samples.

start = designs["force_density"][0].to_nodes(0.004 * np.random.default_rng(0).normal(size=24))
runs, off = {}, {}
for held, (plant, _) in designs.items():
    Q, R = tc.energy_weights(plant, by_mode=held == "rest_length")
    law = tc.LQR(plant, Q, 0.1 * R, sample_time=SAMPLE)
    runs[held] = tc.simulate(
        model, DURATION, start, controller=law, input=held, step=1e-3, output_step=SAMPLE
    )
    shapes = [plant.measure(runs[held].nodes[:, :, k], np.zeros((3, 12)))[:24]
              for k in range(len(runs[held].time))]  # fmt: skip
    off[held] = np.array(
        [np.linalg.norm(plant.to_nodes(q) - structure.nodes, axis=0).max() for q in shapes]
    )
    print(f"{held}: farthest node {1e3 * off[held][0]:.2f} mm off at first, "
          f"{1e3 * off[held][-1]:.4f} mm after {DURATION:g} s")  # fmt: skip

# %%
# Poles in open loop and under the laws in continuous time; the responses are those under laws in
# samples.

figure = plt.figure(figsize=(7.5, 8.0), layout="constrained")
grid = figure.add_gridspec(3, 2, height_ratios=(1.3, 1.0, 1.0))
names = {"force_density": "γ as the input", "rest_length": "rest length as the input"}
for column, (held, (plant, law)) in enumerate(designs.items()):
    ax = figure.add_subplot(grid[0, column])
    tc.plot.poles({"open loop": np.linalg.eigvals(plant.A), "LQR": law.poles}, ax=ax)
    ax.set_title(names[held], pad=42)
drawn = tc.plot.history(
    runs["force_density"].time,
    {names[held]: values for held, values in off.items()},
    "largest node error, m",
    ax=figure.add_subplot(grid[1, :]),
)
drawn.ax.set_yscale("log")
drawn = tc.plot.history(
    runs["force_density"].time,
    {names[held]: run.force_density[6] for held, run in runs.items()},
    "γ of string 6, N/m",
    ax=figure.add_subplot(grid[2, :]),
    references={"at rest": float(rest.force_density[6])},
)
drawn.ax.set_xlim(0.0, 1.0)  # what follows is at rest

if __name__ == "__main__":
    plt.show()
