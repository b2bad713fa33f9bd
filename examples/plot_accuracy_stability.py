"""
How long a step may be
======================

An explicit method becomes unstable when its step is too long for the fastest vibration of the
strings. Stiff, light strings need short steps. Markers show the longest stable steps found on a
prism with a point mass in each string. Lines show the limit by theory: 2√2 over the fastest rate of
the linearized motion.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

stability = tc.stability_map("rk4", [1e2, 1e3, 1e4], [1e-1, 1e-3], steps=200)
print(stability.table())
tc.plot.stability_map(stability)

# %%
# An implicit method has no such limit. Here are strings of 10 GN/m, on a prism that
# turns over: RK4 would need steps of some microseconds, ``energy_momentum`` takes
# 5 ms. The motion as one body is right; the vibration is not resolved, and need not be.

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=1e10))
rest = tc.prestress(prism, force_density=10.0)  # N/m in the top strings; 17.32 in the vertical
lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
spin = np.cross([1.0, 0.0, 0.0], prism.nodes.T).T
run = tc.simulate(
    model,
    2.0,
    velocities=spin,
    rest_length=lengths,
    method="energy_momentum",
    step=5e-3,
    output_step=0.05,
)
print(run.summary())

# sphinx_gallery_thumbnail_number = 2
drawing = tc.plot.structure(prism, faint=True)
tc.plot.structure(run, time=1.0, ax=drawing.ax)

# %%
# Left to itself, ``simulate`` chooses between the two kinds, and says why.

chosen = tc.simulate(model, 2.0, velocities=spin, rest_length=lengths, output_step=0.05)
print(f"{chosen.choice.method}: {chosen.choice.reason}")

if __name__ == "__main__":
    plt.show()
