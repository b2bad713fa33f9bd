"""From a log of a robot with twelve motors to its controller in C."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import tenscontrol as tc

# %% shell
shell = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)  # 24 strings
driven = range(0, 24, 2)  # twelve motors; the other strings are springs
believed = tc.Model(shell, strings=tc.LinearStrings(stiffness=1000.0, damping=3.0))

# %% log
cut = np.full(24, 0.5)  # m
wound = cut.copy()
wound[driven] -= 0.06  # in the log, the motors wind 6 cm within 0.1 s
camera = tc.Sensors(structure=shell, node_position=0.0005)  # m
log = tc.Log.read(
    Path(__file__).with_name("robot.csv"),
    camera,
    rest_length=tc.Profile([0.0, 0.1], np.column_stack([cut, wound])),
    nodes=tc.equilibrium(believed, rest_length=cut).structure.nodes,
)
print(log)

# %% fit
alike = {"stiffness": "all", "damping": "all"}  # all strings have the same
fit = tc.fit(believed, log, ["stiffness", "damping"], groups=alike)
print(fit.table())

# %% robot
robot = replace(
    shell,
    nodes=np.column_stack([shell.nodes, shell.nodes.mean(axis=1)]),  # 12: the payload
    strings=np.vstack([shell.strings, [[k, 12] for k in range(12)]]),
    point_mass=np.append(np.zeros(12), 1.0),  # kg
    string_groups=["shell"] * 24 + ["payload"] * 12,
)
stiffness = np.append(fit.parameters["stiffness"], np.full(12, 300.0))
damping = np.append(fit.parameters["damping"], np.full(12, 1.0))
model = tc.Model(robot, strings=tc.LinearStrings(stiffness, damping))
rest = tc.equilibrium(model, rest_length=np.full(36, 0.5))
plant = tc.linearize(model, rest, input="rest_length", actuated=driven)
print(plant.actuation)

# %% control
winches = tc.Winches(rate=0.3, shortest=0.3, longest=0.8)  # m/s, m
Q, R = tc.energy_weights(plant, by_mode=True)
lqr = tc.LQR(plant, Q, 0.1 * R, sample_time=0.02, winches=winches)
sensors = tc.Sensors(structure=robot, node_position=0.0005)
observer = tc.KalmanFilter(plant, sensors, sample_time=0.02)
made = tc.generate_c(lqr, "robot_c", estimator=observer)

# %% loop
push = np.zeros(robot.nodes.shape)
push[0, :12], push[0, 12] = -0.4, 1.2  # m/s: the payload against the shell
start = {"nodes": rest.structure.nodes, "velocities": push, "step": 2e-3}
scene = {"rest_length": plant.rest_length, **start}
loop = {"estimator": observer, "winches": winches, **scene}
runs = {
    "strings held": tc.simulate(model, 1.0, **scene),
    "LQR": tc.simulate(model, 1.0, controller=lqr, **loop),
    "LQR in C": tc.simulate(model, 1.0, controller=made.compile(), **loop),
}
away = {}
for name, run in runs.items():
    moved = run.nodes - rest.structure.nodes[..., None]
    away[name] = 1e3 * np.linalg.norm(moved, axis=0).max(axis=0)
for name, distance in away.items():
    late = distance[runs[name].time > 0.8].max()
    print(f"{name}: {distance.max():.0f} mm at most, {late:.2f} mm after 0.8 s")
shown = {name: away[name] for name in ("strings held", "LQR in C")}
tc.plot.history(runs["LQR"].time, shown, "farthest node from rest, mm")
