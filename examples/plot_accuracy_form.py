"""
Is it the form of the equations that makes a simulation accurate?
=================================================================

Goyal & Skelton claim that their matrix form gives the most accurate simulations. It has more
coordinates than degrees of freedom. Here the same prism is integrated in that form and in MuJoCo's
minimal coordinates, both by the classical Runge-Kutta method of order 4. MuJoCo comes with the
extra ``bench``; without it its curves are left out.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo
from tenscontrol.dynamics.equation import unpack_states

STEPS = [0.02, 0.01, 0.005, 0.0025, 0.00125]
OUTPUTS = 30

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))


def let_go(vertical, name):
    """Return the prism let go with this force density in its vertical strings."""
    gamma = np.repeat([17.3205, 17.3205, vertical], 3)
    lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    return tc.Scene(model, 3.0, rest_length=lengths, name=name)


drawing = tc.plot.structure(prism, force_density=np.repeat([17.3205, 17.3205, 9.0], 3))
cases = [let_go(25.0, "strings stay taut"), let_go(9.0, "strings go slack")]

# %%
# The third way: our form by the same method, with steps that run across the
# switches of strings as MuJoCo's do.


def across_switches(case, step):
    """Return the nodes at the output times by RK4 on the whole equation, kinks included."""
    f = case.equation().kinked_slope
    x, u = ca.SX.sym("x", f.size1_in(0)), ca.SX.sym("u", f.size1_in(1))
    k1 = f(x, u)
    k2 = f(x + step / 2 * k1, u)
    k3 = f(x + step / 2 * k2, u)
    k4 = f(x + step * k3, u)
    one = ca.Function("one", [x, u], [x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    count = round(case.duration / OUTPUTS / step)
    states = one.fold(count).mapaccum(OUTPUTS)(
        case.state, ca.repmat(case.input_value, 1, count * OUTPUTS)
    )
    return unpack_states(case.structure, np.array(states))[0]


found = {}
for case in cases:
    reference = tc.accuracy.converged_motion(case, OUTPUTS)
    compared = tc.work_precision(
        case,
        ["rk4", "dop853"],
        {"rk4": STEPS, "dop853": [1e-3, 1e-5, 1e-7, 1e-9]},
        peers=[MuJoCo("rk4", settings=STEPS)],
        reference=reference,
        repeats=1,
    )
    print(compared.table(), end="\n\n")
    distances = [across_switches(case, step) - reference.nodes for step in STEPS]
    unlocated = [np.linalg.norm(each, axis=0).max() for each in distances]
    found[case.name] = compared, unlocated

# %%
# While strings stay taut, the two forms have the same error at the same step. Through
# switches, steps that run across them stop gaining: that is so in either form. Ending
# steps at the switches gives the order back, and another method gives the rest.

figure, axes = plt.subplots(2, 2, figsize=(9.0, 8.0), sharey=True, layout="constrained")
COLUMNS = [("rk4", "RK4, ours", "C0", "o-"), ("dop853", "dop853, ours", "C2", "s-")]
for column, (name, (compared, unlocated)) in enumerate(found.items()):
    over_step, over_time = axes[:, column]
    for method, label, color, line in [*COLUMNS, ("mujoco rk4", "RK4, MuJoCo", "0.4", "^--")]:
        if method in (*compared.methods, *compared.peers):
            rows = compared.of(method)
            error = [max(row.error, compared.reference.error) for row in rows]
            if method != "dop853":  # chooses its steps
                over_step.loglog([row.setting for row in rows], error, line, color=color)
            over_time.loglog([row.time for row in rows], error, line, color=color, label=label)
    over_step.loglog(STEPS, unlocated, "x:", color="C3", label="RK4, ours, across switches")
    over_step.set(title=name, xlabel="step, s", xticks=STEPS, xticklabels=[f"{h:g}" for h in STEPS])
    over_step.minorticks_off()
    over_time.set(xlabel="run time, s", xlim=(5e-3, 1.0))
    over_time.minorticks_off()
for ax in axes[:, 0]:
    ax.set_ylabel("largest error of a node, m")
axes[1, 0].legend(fontsize="small")
axes[0, 0].legend(fontsize="small")

# %%
# The error of MuJoCo over that of our RK4, step by step.

share = {}
for name, (compared, _) in found.items():
    if "mujoco rk4" in compared.peers:
        pairs = zip(compared.of("mujoco rk4"), compared.of("rk4"), strict=True)
        share[name] = [theirs.error / ours.error for theirs, ours in pairs]
        print(name, np.round(share[name], 2))

if __name__ == "__main__":
    plt.show()
