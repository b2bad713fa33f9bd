"""
Modes of a dome
===============

A Geiger dome has nine motions that stretch no member, to first order. Only its prestress makes
them stiff. How a dome vibrates depends on what its cables hold: a force density, or a rest length
as a winch does.
"""

import matplotlib.pyplot as plt

import tenscontrol as tc

# %%
# The dome has four states of self-stress. The one chosen here has at least 20 N/m in every cable.
# The residual says how well the forces balance.

dome = tc.library.geiger_dome(sides=6)
rest = tc.prestress(dome, min_force_density=20.0)
print(rest)
print("stable:", rest.is_stable, " super-stable:", rest.is_super_stable)
tc.plot.structure(rest)

# %%
# Rest lengths held: the cables stretch, and every motion has a frequency. Arrows show where nodes
# go. A mode of the kind "mechanism" hardly stretches a cable, so that stiffer cables would not
# raise its frequency.

model = tc.Model(dome, strings=tc.LinearStrings(stiffness=300.0))
held_plant = tc.linearize(model, rest, input="rest_length")
held = tc.modes(held_plant)
print(held.table())
tc.plot.mode_shapes(held_plant, held)

# %%
# Force densities held: four motions have no stiffness at all.

free_plant = tc.linearize(model, rest, input="force_density")
free = tc.modes(free_plant)
print(f"{(free.frequency == 0).sum()} of {len(free)} modes have frequency 0")
tc.plot.mode_shapes(free_plant, free, range(6))

# %%
# Can the cables reach all modes? Two of them, four states, are out of reach by symmetry.

reach = tc.controllability(free_plant)
print(f"{reach.unreachable} of {len(free_plant.A)} states are out of reach")

if __name__ == "__main__":
    plt.show()
