"""Cases that workers can import, and an executor that counts."""

import os
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import tenscontrol as tc


def loop_case(
    structure, strings, controller, duration, step, tolerance, *, target=None, gravity=None,
    ground=None, **settings,
):  # fmt: skip
    """A case of a structure under a controller, or in open loop."""
    model = tc.Model(structure, strings=strings, gravity=gravity, ground=ground)
    scene = tc.Scene(
        model, duration, controller=controller, integration=tc.Integration(step=step), **settings
    )
    return tc.ClosedLoopCase(scene, tolerance, target)


PARAMETERS = {"mass": tc.Uniform(0.8, 1.2, size=3), "delay": tc.Normal(0.0, 0.1)}


class Inline(Executor):
    """Does each run when it is handed in, and remembers which."""

    def __init__(self, interrupt_after=None):
        self.runs = []
        self._interrupt_after = interrupt_after

    def submit(self, function, /, *arguments, **options):
        if len(self.runs) == self._interrupt_after:
            raise KeyboardInterrupt
        self.runs += arguments[-1]
        future = Future()
        try:
            future.set_result(function(*arguments, **options))
        except BaseException as error:
            future.set_exception(error)
        return future


class Waiting(ThreadPoolExecutor):
    """One thread, and the largest number of runs that were handed in and not done."""

    def __init__(self):
        super().__init__(1)
        self._handed_in, self.most = [], 0

    def submit(self, function, /, *arguments, **options):
        future = super().submit(function, *arguments, **options)
        self._handed_in.append(future)
        open_runs = sum(not each.done() for each in self._handed_in)
        self.most = max(self.most, open_runs)
        return future


def noisy(parameters, rng):
    """A number from parameters and noise; a fifth of the runs raises, another is no success."""
    value = parameters["mass"].sum() + parameters["delay"] + 0.01 * rng.normal()
    fate = rng.random()
    if fate < 0.2:
        raise ArithmeticError(f"ran away at {value!r} s")
    return tc.robustness.Outcome(
        success=fate < 0.8, figures={"value": value, "first_mass": parameters["mass"][0]}
    )


def brief(parameters, rng):
    """A run of a few milliseconds."""
    time.sleep(0.003)
    return tc.robustness.Outcome(success=True, figures={"value": rng.random()})


def never_begins(_):
    """The start of a worker that takes ten minutes."""
    time.sleep(600)


def first_of_the_stream(parameters, rng):
    return tc.robustness.Outcome(success=True, figures={"first": rng.random()})


class Remembering:
    """A case that holds state, as a controller does."""

    def __init__(self):
        self.calls = 0

    def __call__(self, parameters, rng):
        self.calls += 1
        return tc.robustness.Outcome(success=True, figures={"calls": self.calls})


def dies(parameters, rng):
    if parameters["x"] < 0.05:
        os._exit(3)
    return tc.robustness.Outcome(success=True)


def not_a_number(parameters, rng):
    return tc.robustness.Outcome(success=True, figures={"error": float("nan")})


def returns_a_number(parameters, rng):
    return 1.0


def without_memory(parameters, rng):
    raise MemoryError("none left")


def changing_figures(parameters, rng):
    return tc.robustness.Outcome(success=True, figures={"a" if parameters["x"] < 0.5 else "b": 1.0})


def stops_the_sweep(parameters, rng):
    raise tc.robustness.SweepError("no such parameter")


def writes_to_its_parameters(parameters, rng):
    parameters["mass"][0] = 1.0
    return tc.robustness.Outcome(success=True)


TOWER = tc.library.class2_tower()
LENGTH = 0.9 * TOWER.string_length(TOWER.nodes)


def damper(time, nodes, velocities):
    """Strings wound in as fast as they grow."""
    strings, rates = TOWER.string_vectors(nodes), TOWER.string_vectors(velocities)
    return LENGTH - 0.02 * (strings * rates).sum(axis=0) / TOWER.string_length(nodes)
