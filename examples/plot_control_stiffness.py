"""
How stiff may strings be?
=========================

Winches hold rest lengths between samples. A controller that commands force densities gets them at
the sample only: then the motion stretches the strings and changes the forces. The stiffer the
strings, the larger the change. A controller that commands rest lengths takes this into account.
"""

import numpy as np
from stiffness_study import draw, stiffness_report

import tenscontrol as tc

# %%
# A prism is lowered from 1 m to 0.85 m. The way there is the same for all strings.

soft = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
goal = tc.shape_target(soft, low, force_density=17.3205)
start = tc.prestress(tc.prism(), force_density=17.3205)  # N/m, top strings; 30, vertical
path = tc.shape_path(soft, start, goal, duration=1.2, step=0.03)

# %%
# For each stiffness LQR and MPC are designed with either input. MPC follows the way; LQR, which
# follows nothing, is pushed at 0.85 m. The study is ``stiffness_study.py``, a file beside this
# one that you can copy for a structure of your own.

report = stiffness_report(
    goal,
    [1e2, 1e3, 1e4, 1e5],  # N/m
    sample_time=0.02,  # s
    damping=lambda k: 0.02 * np.sqrt(k),  # N s/m
    reference=path.reference(),
    duration=2.0,
    horizon=15,
)
print(report.summary())

# %%
# The stiffer the strings, the more the MPC in γ lags behind; in the end it hardly leaves its
# start. The LQR that is only pushed stays near by itself, but what is left of its errors hardly
# decays: where the lower curve is below a quarter of the rate of the design, the law is not said
# to hold.

drawn = draw(report)

# %%
# The prism at 0.85 m, over its start.

# sphinx_gallery_thumbnail_number = 2
drawing = tc.plot.structure(start, faint=True)
tc.plot.structure(goal, ax=drawing.ax)

if __name__ == "__main__":
    import matplotlib.pyplot as plt

    plt.show()
