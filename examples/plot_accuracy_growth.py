"""
Time and memory of large structures
===================================

How much time and memory do towers of 12 to 3,348 members take? Each goes from structure to plant:
prestress, stability, linearization, the lowest modes, a simulation, and the reduction to 20 modes.
Measured are the processor time of all threads and the memory of the process. A step is left out if
it would need more than a budget.
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

# %%
# A tower of 84 members.

# sphinx_gallery_thumbnail_number = 3
tc.plot.structure(towers[1](), legend=False)

if __name__ == "__main__":
    plt.show()
