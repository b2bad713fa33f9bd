"""
What a structure costs as it grows
==================================

Towers of prisms of 12 to 3,348 members go from structure to a plant: prestress,
stability, linearization, the lowest modes, a simulation, and the reduction to 20 modes.
Each stop is measured by the processor time of all threads and by the memory of the
process, and is left out where more than a budget is foretold.
"""

import matplotlib.pyplot as plt

import tenscontrol as tc

# %%
# Without ``last`` controllers on the reduced plant follow.

STAGES = (1, 4, 14, 42, 140)
towers = [lambda stages=stages: tc.prism_tower(stages) for stages in STAGES]
found = tc.accuracy.growth(towers, seconds=20, memory=2e9, last="reduce")
print(found.table())

# %%
# Along the dashed line cost is in proportion to the members; the legend has the exponent.

tc.plot.growth(found)

# %%
# Memory, over what the process had before.

tc.plot.growth(found, "memory")

if __name__ == "__main__":
    plt.show()
