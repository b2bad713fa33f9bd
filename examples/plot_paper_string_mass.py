"""
Strings with mass: example 1 of the paper
=========================================

Goyal & Skelton cut each string of a prism into four segments with three point masses of 0.01 kg.
The prism starts with too little force in its vertical strings. The strings swing, and the bars move
differently than with massless strings.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

# %%
# The prism (figure 1 of the paper), and force densities that do not balance.

prism = tc.prism(sides=3, radius=0.5, height=1.0, bar_mass=1.0)
gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
tc.plot.structure(prism)

# %%
# Strings of 100 N/m without mass.

light = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
wound = tc.to_rest_length(light, prism.nodes, gamma).rest_length
without_mass = tc.simulate(light, 2.0, rest_length=wound, step=1e-3)

# %%
# With mass. The paper's "all string members are given stiffness values of
# 100 N/m" can be read in two ways: a whole string has 100 N/m, or a segment.

massive = tc.subdivide(prism, segments=4, node_mass=0.01)
whole = tc.Model(massive, strings=tc.LinearStrings(100.0 * tc.structure.segment_counts(massive)))
segment = tc.Model(massive, strings=tc.LinearStrings(100.0))
whole_gamma = tc.structure.spread_force_density(massive, gamma)
runs = {}
for name, model, pull in (
    ("whole string 100 N/m", whole, whole_gamma),
    ("segment 100 N/m", segment, gamma[massive.string_parent]),
):
    start = tc.to_rest_length(model, massive.nodes, pull).rest_length
    runs[name] = tc.simulate(model, 2.0, rest_length=start, step=5e-4, output_step=1e-3)

# %%
# A time-lapse of the first swing (figure 2 of the paper).

run = runs["whole string 100 N/m"]
figure = plt.figure(figsize=(10.5, 3.8))
for i, time in enumerate((0.0, 0.12, 0.3)):
    ax = figure.add_subplot(1, 3, i + 1, projection="3d")
    k = np.searchsorted(run.time, time)
    tc.plot.structure(massive, run.nodes[:, :, k], ax=ax, legend=False)
    ax.set_title(f"{run.time[k]:.2f} s")
    ax.set_axis_off()
figure.subplots_adjust(left=0, right=1, bottom=0, top=0.9, wspace=0)

# %%
# Height of node 1, the paper's count (figure 3 of the paper). The second
# reading is the first at half the speed: all forces are a quarter, the masses
# the same.

curves = {"strings without mass": without_mass.nodes[2, 0]}
curves |= {name: result.nodes[2, 0] for name, result in runs.items()}
tc.plot.history(without_mass.time, curves, "z of node 1, m")

mass_effect = np.abs(run.nodes[2, 0] - without_mass.nodes[2, 0])[:1001].max()
slow = runs["segment 100 N/m"].nodes[2, 0, ::2]
half_speed_error = np.abs(slow[:1001] - run.nodes[2, 0, :1001]).max()
print(f"string mass moves node 1 by up to {100 * mass_effect:.1f} cm in the first second")
print(f"the other reading at double speed is the same motion to {half_speed_error:.1e} m")

if __name__ == "__main__":
    plt.show()
