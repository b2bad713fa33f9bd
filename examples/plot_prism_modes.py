"""
Modes of a prism
================

A tensegrity prism has one infinitesimal mechanism, which only its prestress
stiffens. How it vibrates depends on what its cables hold: their force density,
as a force-controlled cable does, or their rest length, as a winch does.
"""

import matplotlib.pyplot as plt

import tenscontrol as tc

# %%
# The prism rests where the vertical strings have √3 times the force density of
# the horizontal ones. The residual says how well.

prism = tc.prism(sides=3, radius=0.5, height=1.0, bar_mass=1.0)
rest = tc.prestress(prism, force_density=17.320508)
print(rest)
print("stable:", rest.is_stable, " super-stable:", rest.is_super_stable)
tc.plot.structure(prism, force_density=rest.force_density)

# %%
# Force density held: three motions cost nothing. They are affine: the prism is
# stretched or sheared as a whole.

model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
free_plant = tc.linearize(model, rest, input="force_density")
free = tc.modes(free_plant)
print(free.table())
tc.plot.mode_shapes(free_plant, free)

# %%
# Rest length held: the strings stretch, and every motion has a frequency. The
# lowest is the mechanism: it hardly stretches a string, so that stiffer strings
# would not raise it.

held_plant = tc.linearize(model, rest, input="rest_length")
held = tc.modes(held_plant)
print(held.table())
tc.plot.mode_shapes(held_plant, held)

# %%
# All modes are within reach of the strings, with γ as the input, the twist least.

reach = tc.controllability(free_plant)
print(reach.table())

if __name__ == "__main__":
    plt.show()
