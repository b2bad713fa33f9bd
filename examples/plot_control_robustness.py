"""
How robust is a controller?
===========================

A regulator and an MPC are designed on a prism whose masses and stiffnesses are
known. Then the prism is another one: each bar up to 20 % heavier or lighter, each
string up to 30 % stiffer or softer, let go from somewhere near. The controllers
are not told. How often does the prism end up within 2 cm of its shape?
"""

import tenscontrol as tc

TOLERANCE = 0.02  # m

prism, strings = tc.prism(), tc.LinearStrings(100.0, damping=0.5)

# %%
# Both command rest lengths. A string that is softer than it should be pulls less at
# the rest length that is meant to balance it, and the prism settles in another
# shape. The regulator does not make up for that. The MPC takes it for an unknown load and
# estimates that.


def controllers():
    """Return the controllers by name, designed on the nominal prism."""
    rest = tc.prestress(prism, force_density=17.320508)
    plant = tc.linearize(tc.Model(prism, strings=strings), rest, input="rest_length")
    Q, R = tc.energy_weights(plant)
    return {
        "LQR": tc.lqr(plant, Q, 0.1 * R, step=0.02),
        "MPC": tc.MPC(plant, horizon=8, step=0.04, max_force_density=65.0, load_gain=0.3),
    }


# %%
# ``ClosedLoopCase`` gives the plant what is drawn, and leaves the controller as it
# was designed. A sweep starts processes, and these read this file again, under
# another name: they must not start a sweep in turn.

drawn = {
    "stiffness": tc.Uniform(0.7, 1.3, size=9),
    "bar_mass": tc.Uniform(0.8, 1.2, size=3),
    "start": tc.Normal(0.0, 0.005, size=9),
}
counts = {"LQR": 200, "MPC": 20}
reports = {}
if __name__ != "__mp_main__":
    for name, controller in controllers().items():
        case = tc.ClosedLoopCase(
            prism, strings, controller, duration=1.2, step=1e-2, tolerance=TOLERANCE
        )
        reports[name] = tc.sweep(case, drawn, counts[name], seed=0)
        print(f"{name}: {reports[name].summary()}\n")

# %%
# Left: the runs over the two stiffnesses that go with the error most. Right: the part
# of the runs that ends up within a distance. The interval says how well so many runs
# tell the rate.

for name, report in reports.items():
    figure = tc.plot.sweep(report, "final_error", unit="m", limit=TOLERANCE).axes[0].figure
    figure.suptitle(f"{name}, {len(report)} runs")

if __name__ == "__main__":
    import matplotlib.pyplot as plt

    plt.show()
