"""
Long runs, and motions that cannot be predicted for long
========================================================

Over many steps it matters what a method conserves, more than its order. RK4 loses a little energy
at every step, and bars stretch. The energy-momentum method keeps energy and bar lengths to
round-off.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
gamma = np.repeat([17.3205, 17.3205, 45.0], 3)
lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
case = tc.Scene(model, 1.0, rest_length=lengths)

# %%
# 250 s in steps of 5 ms and 50 ms. The slope of a line through the error comes with its 95 %
# interval; where that covers zero, no drift was found.

figure, axes = plt.subplots(2, 1, figsize=(8.0, 6.0), layout="constrained")
runs = {}
for ax, (method, step) in zip(axes, {"rk4": 5e-3, "energy_momentum": 5e-2}.items(), strict=True):
    runs[method] = tc.long_run(case, method, step, steps=round(250 / step))
    print(runs[method].table(), end="\n\n")
    tc.plot.long_run(runs[method], ax=ax)

# %%
# How long two computed motions can agree at all depends on the motion. The prism whose
# strings go slack is good for a few seconds. With a slack skin on its ends
# (example 2 of the paper without prestress) a perturbation grows so fast that after
# a second round-off alone makes errors of a nanometre.


def let_go(structure, gamma):
    """Return the motion from the shape of the structure with these force densities."""
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=100.0))
    lengths = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    return tc.Scene(model, 5.0, rest_length=lengths)


short = np.repeat([17.3205, 17.3205, 9.0], 3)
skinned = tc.skin(prism, panels=("top", "bottom"), iterations=2, node_mass=0.01)
scenes = {
    "no skin": let_go(prism, short),
    "slack skin": let_go(skinned, np.r_[short, np.zeros(len(skinned.strings) - 9)]),
}
growth = {name: tc.predictability(scene, samples=1) for name, scene in scenes.items()}
figure, ax = plt.subplots(figsize=(8.0, 4.0), layout="constrained")
for name, found in growth.items():
    print(f"{name}: {found.summary()}")
    ax.semilogy(found.time, found.growth, label=f"{name}, {found.rate:.2g} per s")
ax.set(xlabel="time, s", ylabel="growth of a perturbation")
ax.legend()

# %%
# The prism with a skin on both ends.

# sphinx_gallery_thumbnail_number = 3
tc.plot.structure(skinned)

if __name__ == "__main__":
    plt.show()
