"""
Error against run time
======================

Which method is fastest at a given error? A prism starts out of balance, and strings go slack. Each
of our methods, SciPy and MuJoCo integrate its motion at several settings. Errors are distances from
a reference on which two codes agree.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo, SciPy

# %%
# Example 1 of the paper, without the mass of the strings.

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
case = tc.Scene(model, 3.0, rest_length=lengths, name="prism with slack strings")
tc.plot.structure(prism, force_density=gamma)

# %%
# Run times are of a second call, whole, here with nothing compiled.
# A peer that is not installed is named in the summary and left out. MuJoCo comes
# with the extra ``bench``.

steps = [2e-2, 1e-2, 5e-3, 2.5e-3]
tolerances = [1e-3, 1e-5, 1e-7, 1e-9, 1e-11]
settings = {"rk4": steps, "energy_momentum": steps, "dop853": tolerances}
compared = tc.work_precision(
    case,
    list(settings),
    settings,
    peers=[SciPy("DOP853", settings=tolerances), MuJoCo("rk4", settings=steps)],
    repeats=1,
    outputs=30,
)
print(compared.table())

# %%
# To the right is more accurate, further down is faster.

tc.plot.work_precision(compared)

# %%
# Run times by that of our fastest method, at errors that both reach.

ratios = compared.ratios([1e-3, 1e-5, 1e-7])
print(ratios.table())

if __name__ == "__main__":
    plt.show()
