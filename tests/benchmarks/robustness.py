"""A sweep of 200 runs: its rate of success, and the same numbers on one process, two, and Dask.

Run: ``python -m tests.benchmarks.robustness``, some minutes. Masses off by 20 %, stiffnesses by
30 %, readings with noise and late. Prints the rates with their intervals, whether the reports are
equal to the last bit, and the time of two processes over that of one. The Dask cluster of two
workers needs the extra ``distributed``.

``--scenes ball tower tower-mpc`` are other sweeps: runs that go together in compiled loops, beside
one by one, in processor time of one thread. Stiffnesses are off by 30 % in a six-bar ball let go in
shapes of its own, and in a tower whose bars share nodes, under the compiled code of LQR and MPC.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import tenscontrol as tc
from tests.benchmarks.command_line import options

COUNT, SEED, DURATION = 200, 0, 2.4
MANY = 48  # runs from which a sweep lets them go together
PARAMETERS = {
    "stiffness": tc.Uniform(0.7, 1.3, size=9),
    "bar_mass": tc.Uniform(0.8, 1.2, size=3),
    "start": tc.Normal(0.0, 0.005, size=9),
    "noise": tc.Uniform(0.5, 2.0),
    "delay": tc.OneOf([0, 1, 2]),
}


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, count=COUNT, duration=DURATION, scenes=("executors",), alone=50
    )
    for name in (each for each in given.scenes if each != "executors"):
        together(name, given.count, given.duration, given.alone)
    if "executors" not in given.scenes:
        return
    case = closed_loop(load=True, duration=given.duration)
    reports, times = {}, {}
    for name, processes in (("1 process", 1), ("2 processes", 2)):
        # Processes are started anew: a fork of a process that has threads can lock up.
        with ProcessPoolExecutor(processes, get_context("spawn")) as executor:
            list(executor.map(warm_up, range(processes)))
            reports[name], times[name] = timed(case, executor, given.count)
            if processes == 2:
                unaware = closed_loop(load=False, duration=given.duration)
                without, _ = timed(unaware, executor, given.count)
    reports["Dask, 2 workers"], _ = on_dask(case, given.count)
    first = reports["1 process"]
    print(f"The filter estimates a load. {first.summary()}\n")
    print(f"It does not. {without.summary()}\n")
    for name in ("2 processes", "Dask, 2 workers"):
        same = first._records == reports[name]._records
        print(f"{name}: equal to 1 process to the last bit: {'yes' if same else 'NO'}")
    print(f"time of 2 processes / 1 process: {times['2 processes'] / times['1 process']:.2f}")


def closed_loop(load: bool, duration: float = DURATION) -> tc.ClosedLoopCase:
    """Return the prism under an MPC of rest lengths that is told an estimate."""
    prism, strings = tc.prism(), tc.LinearStrings(100.0, damping=0.5)
    rest = tc.prestress(prism, force_density=17.320508)
    plant = tc.linearize(tc.Model(prism, strings=strings), rest, input="rest_length")
    sensors = tc.Sensors(structure=prism, string_length=0.001, bar_direction=0.005, delay=1)
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.04, process_noise=0.2, load=load)
    mpc = tc.MPC(plant, horizon=8, sample_time=0.04, max_force_density=65.0, load_gain=0.1)
    scene = tc.Scene(
        tc.Model(prism, strings=strings), duration, controller=mpc, estimator=estimator,
        integration=tc.Integration(step=1e-2),
    )  # fmt: skip
    return tc.ClosedLoopCase(scene, tolerance=0.02)


def together(name: str, count: int, duration: float, alone: int) -> None:
    """Print the time of runs that go together, and of the first of them one by one."""
    with TemporaryDirectory() as folder:
        case, drawn = ball(duration) if name == "ball" else tower(name, duration, Path(folder))
    print(f"{name}: {count} runs of {case.scene.duration:g} s")
    print("runs  ms of processor time a run")
    found = []
    with ThreadPoolExecutor(1) as executor:
        tc.sweep(case, drawn, MANY, seed=SEED + 1, executor=executor)  # what compiles has compiled
        for each, runs in ((case, count), (OneByOne(case), min(alone, count))):
            began = process_time()
            report = tc.sweep(each, drawn, runs, seed=SEED, executor=executor)
            found.append((report, (process_time() - began) / runs))
            print(f"{runs:4d} {1e3 * found[-1][1]:8.1f}  {report.back_end}")
    (many, quick), (few, slow) = found
    same = few._records == many._records[: len(few)]
    print(f"{name}: one by one / together {slow / quick:.1f}, equal to the last bit: {same}")


class OneByOne:
    """A case whose runs do not go together: for a sweep it is a function."""

    def __init__(self, case: tc.ClosedLoopCase) -> None:
        self._case = case

    def __call__(self, parameters, rng):
        return self._case(parameters, rng)


def ball(duration: float) -> tuple[tc.ClosedLoopCase, dict]:
    """Return a six-bar ball in open loop that starts in shapes of its own."""
    structure, strings = tc.library.six_bar_ball(), tc.LinearStrings(1000.0)
    rest = tc.prestress(structure, force_density=20.0)
    model = tc.Model(structure, strings=strings)
    lengths = tc.to_rest_length(model, structure.nodes, rest.force_density).rest_length
    steps = tc.Integration(step=2e-3)
    scene = tc.Scene(model, duration, rest_length=lengths, integration=steps)
    return tc.ClosedLoopCase(scene, 0.1), {
        "stiffness": tc.Uniform(0.7, 1.3, size=len(structure.strings)),
        "start": tc.Normal(0.0, 0.02, size=24),
    }


def tower(name: str, duration: float, folder: Path) -> tuple[tc.ClosedLoopCase, dict]:
    """Return a tower whose bars share nodes under compiled LQR, or MPC."""
    structure, strings = tc.library.class2_tower(), tc.LinearStrings(1000.0, damping=1.0)
    rest = tc.prestress(structure, force_density=20.0)
    model = tc.Model(structure, strings=strings)
    plant = tc.linearize(model, rest, input="rest_length")
    if name == "tower":
        Q, R = tc.energy_weights(plant)
        law = tc.LQR(plant, Q, 0.1 * R, sample_time=0.02)
    else:
        law = tc.MPC(plant, horizon=10, sample_time=0.02)
    code = tc.generate_c(law, folder / "law").compile()
    scene = tc.Scene(model, duration, controller=code, integration=tc.Integration(step=2e-3))
    return tc.ClosedLoopCase(scene, 0.02), {
        "stiffness": tc.Uniform(0.7, 1.3, size=len(structure.strings)),
        "start": tc.Normal(0.0, 0.01, size=plant.degrees_of_freedom),
    }


def timed(case, executor, count):
    began = perf_counter()
    report = tc.sweep(case, PARAMETERS, count, seed=SEED, executor=executor, in_flight=8)
    return report, perf_counter() - began


def on_dask(case, count):
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        return timed(case, client.get_executor(), count)


def warm_up(_: int) -> None:
    """Load what runs need, so that starting a process is not timed."""
    tc.sweep  # noqa: B018
    import casadi  # noqa: F401


if __name__ == "__main__":
    main()
