"""Threads that build, run, pickle, share and drop; each number is compared with one thread's alone.

``python -m tests.fuzz.threads --seconds 300 --threads 4`` is the whole campaign. It prints a
table of the jobs, and ends with status 1 if a number differs or anything raises.
"""

import argparse
import copy
import faulthandler
import gc
import os
import pickle
import random
import sys
import threading
import time
import traceback
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import tenscontrol as tc

STILL = np.zeros((3, 6))
SEEDS = range(3)
PRISM = tc.prism()
LAW = tc.LinearStrings(100.0)
REST = tc.prestress(PRISM, force_density=17.3205)
SHARED = tc.Model(PRISM, strings=LAW)

METHODS = {
    "rk4": {"step": 1e-3},
    "dop853": {"tolerance": 1e-7},
    "energy_momentum": {"step": 2e-3},
    "cvodes": {"tolerance": 1e-6},
}


def plant_of(model, input="rest_length"):
    return tc.linearize(model, REST, input=input)


def lengths(seed):
    gamma = np.repeat([17.3205, 17.3205, 9.0 + seed], 3)
    return tc.to_rest_length(SHARED, PRISM.nodes, gamma).rest_length


def commands(controller, seed, count=4):
    """Return commands at displaced shapes."""
    plant, values = controller.plant, []
    rng = np.random.default_rng(seed)
    for k in range(count):
        nodes = plant.to_nodes(0.01 * rng.standard_normal(plant.degrees_of_freedom))
        values.append(controller.command(0.02 * k, nodes, STILL).value)
    return np.array(values)


def model_functions(seed):
    model = tc.Model(PRISM, strings=tc.LinearStrings(90.0 + seed), external_force=True)
    load = seed * np.ones((3, 6))
    value = model.acceleration(PRISM.nodes, STILL, REST.force_density, load)
    return [value.full(), model.kinetic_energy(np.ones(36)).full()]


def linearize(seed):
    plant = plant_of(tc.Model(PRISM, strings=tc.LinearStrings(90.0 + seed)))
    return [plant.A, plant.B, tc.modes(plant).frequency]


def lqr(seed):
    return [commands(tc.LQR(plant_of(SHARED), sample_time=0.02), seed)]


def mpc(seed):
    plant = plant_of(tc.Model(PRISM, strings=LAW))
    return [commands(tc.MPC(plant, sample_time=0.02, horizon=5 + seed), seed)]


def nmpc(seed):
    return [commands(tc.NMPC(plant_of(SHARED), sample_time=0.02, horizon=3), seed)]


def feedback_linearization(seed):
    plant = plant_of(tc.Model(PRISM, strings=LAW), "force_density")
    law = tc.FeedbackLinearization(plant, sample_time=0.02, max_force_density=80.0, frequency=1.0)
    return [commands(law, seed)]


def pickled(seed):
    """Copy a controller that has run, and go on with the copy."""
    controller = tc.NMPC(plant_of(SHARED), sample_time=0.02, horizon=3)
    controller.reset()
    make = copy.deepcopy if seed == 0 else lambda value: pickle.loads(pickle.dumps(value))
    return [commands(make(controller), seed), plant_of(make(SHARED)).A]


def kalman(seed):
    plant = plant_of(SHARED, "force_density")
    sensors = tc.Sensors(structure=PRISM, string_length=1e-3, node_position=5e-3)
    prediction = "nonlinear" if seed else "linear"
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02, prediction=prediction)
    rng, found = np.random.default_rng(seed), []
    for _ in range(3):
        reading = sensors.disturb(sensors.measure(PRISM.nodes), rng)
        found.append(estimator.update(reading).state)
        estimator.predict(plant.equilibrium_input)
    return found


def equilibrium(seed):
    held = tc.Structure(PRISM.nodes, PRISM.bars, PRISM.strings, 1.0, fixed=[3, 4, 5])
    model = tc.Model(held, strings=tc.LinearStrings(500.0 + seed), gravity=9.81)
    gamma = tc.statics.prism_force_density(3, 60.0)[0]
    wound = tc.to_rest_length(model, PRISM.nodes, gamma).rest_length
    return [tc.equilibrium(model, rest_length=wound).structure.nodes]


def shape(seed):
    low = tc.Height(0.85 + 0.02 * seed, top=[0, 1, 2], bottom=[3, 4, 5])
    goal = tc.shape_target(SHARED, low, force_density=17.3205)
    return [goal.nodes, tc.shape_path(SHARED, REST, goal, duration=2.0).nodes]


def closed_loop(seed):
    controller = tc.MPC(plant_of(SHARED), sample_time=0.02, horizon=5)
    push = np.outer([0.02 * (1 + seed), 0.0, 0.0], np.ones(6))
    return [tc.simulate(SHARED, 0.1, controller=controller, velocities=push).nodes]


def run_with(method, model_of):
    def run(seed):
        model, options = model_of(), METHODS[method]
        return [tc.simulate(model, 0.1, rest_length=lengths(seed), method=method, **options).nodes]

    return run


JOBS = {
    job.__name__: job
    for job in (
        *(model_functions, linearize, lqr, mpc, nmpc, feedback_linearization, pickled, kalman),
        *(equilibrium, shape, closed_loop),
    )
}
JOBS |= {f"{name} shared": run_with(name, lambda: SHARED) for name in METHODS}
JOBS |= {
    f"{name} fresh": run_with(name, lambda: tc.Model(PRISM, strings=LAW))
    for name in ("rk4", "cvodes")
}

# Controllers that all threads call: each command is right or refused.
TOGETHER = {
    "NMPC": tc.NMPC(plant_of(SHARED), sample_time=0.02, horizon=3),
    "MPC": tc.MPC(plant_of(SHARED), sample_time=0.02, horizon=5),
    "feedback linearization": tc.FeedbackLinearization(
        plant_of(SHARED, "force_density"), sample_time=0.02, max_force_density=80.0, frequency=1.0
    ),
}


def share(name):
    """Call a controller that others call too; return whether it was refused."""
    controller = TOGETHER[name]
    try:
        command = controller.command(0.0, PRISM.nodes, STILL)
    except RuntimeError as error:
        if "in use by another thread" not in str(error):
            raise
        return True
    if not np.isfinite(command.value).all():
        raise ArithmeticError(f"{name} commands {command.value}")
    return False


def same(found, expected):
    return all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))


def campaign(seconds, threads, seed, jobs=JOBS):
    """Return counts of outcomes by job, and what went wrong."""
    alone = {(name, k): job(k) for name, job in jobs.items() for k in SEEDS}
    outcomes, wrong, end = Counter(), [], time.monotonic() + seconds

    def work(number):
        choose = random.Random(1000 * seed + number)
        while time.monotonic() < end and not wrong:
            try:
                for name in TOGETHER:
                    refused = share(name)
                    outcomes[f"{name} by all", "refused" if refused else "right"] += 1
                name, k = choose.choice(list(alone))
                good = same(jobs[name](k), alone[name, k])
                outcomes[name, "right" if good else "other numbers"] += 1
                if not good:
                    wrong.append(f"{name}, seed {k}: other numbers than alone")
                if choose.random() < 0.1:
                    gc.collect()
            except Exception:
                wrong.append(traceback.format_exc())

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(threads)))
    return outcomes, wrong


def designs(count, threads):
    """Return whether designs by some threads, so many each, are those of one."""

    def design(k):
        plant = plant_of(tc.Model(PRISM, strings=tc.LinearStrings(80.0 + k)))
        return [tc.LQR(plant).gain if k % 4 else tc.MPC(plant, sample_time=0.02, horizon=4).bounds]

    alone = [design(k) for k in range(count)]
    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(lambda i: design(i % count), range(threads * count)))
    return all(same(one, alone[i % count]) for i, one in enumerate(found))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--threads", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--designs", type=int, default=0, help="designs a thread, before the rest")
    parser.add_argument("--jobs", nargs="*", default=list(JOBS), help="names of jobs")
    given = parser.parse_args()
    faulthandler.enable()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.setswitchinterval(1e-4)
    if given.designs:
        fine = designs(given.designs, given.threads)
        print(f"{given.threads} threads x {given.designs} designs:", "same" if fine else "OTHER")
        if not fine:
            return 1
    faulthandler.dump_traceback_later(given.seconds + 240.0, exit=True)  # where it hangs
    jobs = {name: JOBS[name] for name in given.jobs}
    outcomes, wrong = campaign(given.seconds, given.threads, given.seed, jobs)
    for (name, outcome), count in sorted(outcomes.items()):
        print(f"{name:32s} {outcome:14s} {count:7d}")
    print(f"{sum(outcomes.values())} in all, {threading.active_count()} thread left")
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
