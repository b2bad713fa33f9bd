"""
Skins: example 2 of the paper
=============================

A skin is a mesh of strings over a panel: a node at its centre, strings to its vertices, and the
same again inside each triangle. It stiffens a panel in tension. In a panel that contracts it goes
slack and has almost no effect.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

# %%
# The construction, iteration by iteration (figure 4 of the paper).

prism = tc.prism(sides=3, radius=0.5, height=1.0, bar_mass=1.0)
figure = plt.figure(figsize=(10.5, 3.2))
for n in range(4):
    ax = figure.add_subplot(1, 4, n + 1, projection="3d")
    shape = tc.skin(prism, panels=("top", "bottom"), iterations=n, node_mass=0.01)
    tc.plot.structure(shape, ax=ax, legend=False)
    ax.set_title(f"n = {n}: {shape.nodes.shape[1]} nodes", fontsize="small")
    ax.set_axis_off()
figure.subplots_adjust(left=0, right=1, bottom=0, top=0.9, wspace=0)

# %%
# The prism with skin on top and bottom, n = 2 (figure 5 of the paper).

# sphinx_gallery_thumbnail_number = 2
skinned = tc.skin(prism, panels=("top", "bottom"), iterations=2, node_mass=0.01)
tc.plot.structure(skinned)

# %%
# With and without skin (figure 6 of the paper). The paper gives neither
# stiffness nor prestress of the skin; here it has 100 N/m a string, like the
# rest, and is just taut at the start. With γ_v = 9 N/m the panels contract; with
# γ_v = 45 N/m they expand.


def run(structure, vertical, duration):
    """Let the structure go; skin strings are just taut."""
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=100.0))
    gamma = np.zeros(len(structure.strings))
    gamma[:9] = np.repeat([17.3205, 17.3205, vertical], 3)
    wound = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    return tc.simulate(model, duration, rest_length=wound, step=5e-4, output_step=1e-3)


travel = {}
figure, axes = plt.subplots(1, 2, figsize=(10.5, 3.4), layout="constrained")
for ax, vertical, title in zip(
    axes, (9.0, 45.0), ("panels contract", "panels expand"), strict=True
):
    results = {
        "without skin": run(prism, vertical, 1.0),
        "with skin": run(skinned, vertical, 1.0),
    }
    time = results["without skin"].time
    curves = {name: result.nodes[2, 0] for name, result in results.items()}
    tc.plot.history(time, curves, "z of node 1, m", ax=ax)
    ax.set_xlabel(f"time, s   (γ_v = {vertical:g} N/m: {title})")
    for name, curve in curves.items():
        travel[vertical, name] = np.ptp(curve)

# %%
# How far node 1 travels with skin, as a part of what it travels without. Only
# the first second is compared: with a slack skin the motion is chaotic, and
# soon no two computations agree.

for vertical in (9.0, 45.0):
    share = travel[vertical, "with skin"] / travel[vertical, "without skin"]
    print(f"γ_v = {vertical:g} N/m: {100 * share:.0f} %")

if __name__ == "__main__":
    plt.show()
