"""
Order of a method, also where strings go slack
==============================================

A method of order p has an error in proportion to the p-th power of its step, as long as the forces
are smooth. The force of a string that goes slack has a kink. Therefore a step ends where a string
goes slack, and the next step begins there.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import unpack_states

# %%
# A prism let go with too little force in its vertical strings: they hold, and the
# horizontal ones go slack and taut again.

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
case = tc.Scene(model, 3.0, rest_length=lengths)
reference = tc.accuracy.converged_motion(case, outputs=30)
print(reference.summary())

# %%
# The order of two methods, fitted.

steps = [0.01, 0.005, 0.0025, 0.00125, 0.000625]
methods = ("rk4", "energy_momentum")
orders = {name: tc.convergence_order(case, name, steps, reference) for name in methods}
for order in orders.values():
    print(order.table(), end="\n\n")

# %%
# RK4 once more, with steps that run across the switches.

f = case.equation().kinked_slope
x, u = ca.SX.sym("x", f.size1_in(0)), ca.SX.sym("u", f.size1_in(1))
across = []
for step in steps:
    k1 = f(x, u)
    k2 = f(x + step / 2 * k1, u)
    k3 = f(x + step / 2 * k2, u)
    k4 = f(x + step * k3, u)
    one = ca.Function("one", [x, u], [x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    count = round(case.duration / 30 / step)
    states = one.fold(count).mapaccum(30)(case.state, ca.repmat(case.input_value, 1, 30 * count))
    nodes = unpack_states(prism, np.array(states))[0]
    across.append(np.linalg.norm(nodes - reference.nodes, axis=0).max())
    print(f"step {step:g} s: error {across[-1]:.1e} m")
gain = orders["rk4"].error[-1] / across[-1]
print(f"at the finest step, ending steps at switches leaves {gain:.0e} of the error")

figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.4), sharey=True, layout="constrained")
for ax, order in zip(axes, orders.values(), strict=True):
    tc.plot.convergence_order(order, ax=ax)
    ax.plot(steps, across, "x:", color="0.35")
    ax.annotate("rk4 across switches", (steps[-1], across[-1]), (0, 32), textcoords="offset points")

# %%
# The prism after a second, over its start.

# sphinx_gallery_thumbnail_number = 2
drawing = tc.plot.structure(prism, faint=True)
tc.plot.structure(prism, reference.nodes[:, :, 10], ax=drawing.ax)

if __name__ == "__main__":
    plt.show()
