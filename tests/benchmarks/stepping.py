"""Samples a second of robots that are stepped, beside MuJoCo, at measured error, in one thread.

Run: ``python -m tests.benchmarks.stepping``, one or two minutes on an idle core. A six-bar ball
stands on ground; in each sample of 20 ms its 24 strings get rest lengths at random. 1, 16, 256 and
1,024 of them are stepped by both methods of :class:`tenscontrol.Stepper`, by MuJoCo's ``mj_step``
(one robot) and by its ``rollout`` (several), each with the same numbers of steps. MuJoCo hands out
states, not nodes, which is less work.

The error of a step is the largest distance of a node after 10 samples from where a step that is
``FINER`` times finer than the finest brings it, over the size of the ball: the median of some
robots. Each is judged by itself, as MuJoCo's contacts are not ours. Times are processor time, the
least of some rounds in turns. The last lines say how many times faster ours is where it errs no
more than MuJoCo: each of MuJoCo's steps beside our fastest of those. Then follows what a step costs
beside the compiled core, in Python: processor time without that of the calls of the core, of robots
that are alike, of robots with parameters of their own, and of robots with sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import process_time, thread_time_ns

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers.rigid_bodies import NodeReader
from tenscontrol.core.library import library
from tests.benchmarks.command_line import options

SAMPLE, LENGTH, SPREAD = 0.02, 0.55, 0.02
JUDGED, SAMPLES, FINER = 9, 10, 8

# Samples of all robots together that are timed at once.
MOST = 2048

# Commands of the robots, (count, α), sample after sample, to all nodes or states at the end.
Play = Callable[[Sequence[np.ndarray]], np.ndarray]


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, counts=(1, 16, 256, 1024), parts=(2, 3, 4, 5, 6, 8, 20), rounds=2,
        seconds=0.4,
    )  # fmt: skip
    model = ball()
    start = tc.plant.set_down(model, [0, 4, 8])
    located = ours(model, start, method="rk4")
    methods = {"Stepper": ours(model, start), "Stepper rk4": located} | theirs(model, start)
    finest = FINER * max(given.parts)
    errors = {name: errors_of(make, given.parts, finest) for name, make in methods.items()}
    print(f"{'':22} steps  error of    samples a second of so many robots")
    print(f"{'':22} each   10 samples  " + "".join(f"{count:>10,}" for count in given.counts))
    rates = {}
    for name in methods:
        for parts in given.parts:
            rates[name, parts] = [0.0] * len(given.counts)
    for place, count in enumerate(given.counts):
        plays = {(name, parts): methods[name](parts, count) for name, parts in rates}
        for _ in range(given.rounds):
            for key, play in plays.items():
                rate = rate_of(play, count, given.seconds / given.rounds)
                rates[key][place] = max(rates[key][place], rate)
    for (name, parts), row in rates.items():
        numbers = "".join(f"{rate:>10,.0f}" for rate in row)
        print(f"{name:22} {parts:4d}   {errors[name][parts]:.1e}     {numbers}")
    for name in (each for each in methods if each != "Stepper"):
        for parts in given.parts:
            most = errors[name][parts]
            able = [own for own in given.parts if errors["Stepper"][own] <= most]
            if not able:
                continue
            times = [
                max(rates["Stepper", own][k] for own in able) / rates[name, parts][k]
                for k in range(len(given.counts))
            ]
            print(
                f"Stepper over {name}, {parts} steps, at {most:.1e}: "
                + ", ".join(f"{ratio:.1f}" for ratio in times)
            )
    print(f"\n{'Python, µs a robot and step':34}" + "".join(f"{n:>10,}" for n in given.counts))
    for name, changes in kinds(model).items():
        row = [python_time(model, start, count, given.seconds, changes) for count in given.counts]
        print(f"{name:34}" + "".join(f"{time:>10.1f}" for time in row))


def kinds(model: tc.Model) -> dict[str, Callable[[int], dict]]:
    """Return what robots have beside the model, by their number."""
    random = np.random.default_rng(0)
    sensors = tc.Sensors(structure=model.structure, bar_inclination=0.01, gyroscope=0.01)
    return {
        "alike": lambda count: {},
        "with parameters of their own": lambda count: {
            "parameters": {
                "stiffness": random.uniform(900.0, 1100.0, (count, 24)),
                "ground.friction": random.uniform(0.3, 0.9, count),
                "bar_mass": random.uniform(0.4, 0.6, (count, 6)),
            }
        },
        "with inclinations and gyroscopes": lambda count: {"sensors": sensors},
    }


def python_time(
    model: tc.Model, start: np.ndarray, count: int, seconds: float,
    changes: Callable[[int], dict],
) -> float:  # fmt: skip
    """Return the processor time of a step beside the core, µs a robot, the least of some."""
    robots = tc.Stepper(
        model, SAMPLE, step=SAMPLE / 5, nodes=start, rest_length=LENGTH, count=count,
        **changes(count),
    )  # fmt: skip
    commands, least, taken = commands_of(count, SAMPLES), np.inf, 0.0
    with core_time() as spent:
        while taken < seconds:
            robots.reset()
            begin, inside = thread_time_ns(), spent[0]
            for command in commands:
                robots.step(command)
            whole = thread_time_ns() - begin
            taken += whole * 1e-9
            least = min(least, whole - (spent[0] - inside))
    return float(least) * 1e-3 / (len(commands) * count)


@contextmanager
def core_time() -> Iterator[list[int]]:
    """Yield a list of the time within calls of the core, ns."""
    core, spent = library(), [0]

    def timed(call):
        def wrapped(*arguments):
            begin = thread_time_ns()
            try:
                return call(*arguments)
            finally:
                spent[0] += thread_time_ns() - begin

        return wrapped

    names = "tc_advance", "tc_taut", "tc_advance_runs"
    calls = {name: getattr(core, name) for name in names}
    try:
        for name, call in calls.items():
            setattr(core, name, timed(call))
        yield spent
    finally:
        for name, call in calls.items():
            setattr(core, name, call)


def ball() -> tc.Model:
    """Return the model: a ball with damped strings on ground with friction."""
    structure = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    law = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05)
    return tc.Model(structure, strings=law, gravity=9.81, ground=ground)


def ours(
    model: tc.Model, start: np.ndarray, method: str = "rk4_plain"
) -> Callable[[int, int], Play]:
    def make(parts: int, count: int) -> Play:
        robots = tc.Stepper(
            model, SAMPLE, step=SAMPLE / parts, method=method, nodes=start, rest_length=LENGTH,
            count=count,
        )  # fmt: skip

        def play(commands: Sequence[np.ndarray]) -> np.ndarray:
            robots.reset()
            for command in commands:
                nodes, _ = robots.step(command)
            return nodes

        return play

    return make


def theirs(model: tc.Model, start: np.ndarray) -> dict[str, Callable[[int, int], Play]]:
    """Return what MuJoCo does, by its integrators."""
    import mujoco
    from mujoco import rollout

    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS

    def maker(integrator: str) -> Callable[[int, int], Play]:
        def make(parts: int, count: int) -> Play:
            text = tc.exchange.to_mujoco(
                model, rest_length=LENGTH, nodes=start, actuators="rest_length",
                step=SAMPLE / parts, integrator=integrator,
            )  # fmt: skip
            compiled = mujoco.MjModel.from_xml_string(text)
            data, reader = mujoco.MjData(compiled), NodeReader(compiled, model.structure)
            mujoco.mj_resetDataKeyframe(compiled, data, 0)
            first = np.empty(mujoco.mj_stateSize(compiled, kind))
            mujoco.mj_getState(compiled, data, first, kind)

            def nodes_of(states: np.ndarray) -> np.ndarray:
                read = []
                for state in states:
                    mujoco.mj_setState(compiled, data, state, kind)
                    read.append(reader.read(data))
                return reader.motion(read)[0].transpose(2, 0, 1)

            def one(commands: Sequence[np.ndarray]) -> np.ndarray:
                mujoco.mj_setState(compiled, data, first, kind)
                for command in commands:
                    data.ctrl[:] = command[0]
                    mujoco.mj_step(compiled, data, parts)
                return data.site_xpos[None]

            def several(commands: Sequence[np.ndarray]) -> np.ndarray:
                states = np.tile(first, (count, 1))
                for command in commands:
                    control = np.repeat(command[:, None], parts, axis=1)
                    states = rollout.rollout(compiled, data, states, control)[0][:, -1]
                return states

            several.nodes_of = nodes_of  # type: ignore[attr-defined]  # for the judge
            return one if count == 1 else several

        return make

    return {f"MuJoCo {name}": maker(name) for name in ("rk4", "implicitfast")}


def commands_of(count: int, samples: int) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    return [LENGTH + random.uniform(-SPREAD, SPREAD, (count, 24)) for _ in range(samples)]


def errors_of(
    make: Callable[[int, int], Play], parts: Sequence[int], finest: int
) -> dict[int, float]:
    """Return the error of each number of steps a sample, by itself at a finer step."""
    commands = commands_of(JUDGED, SAMPLES)

    def nodes(each: int) -> np.ndarray:
        play = make(each, JUDGED)
        end = play(commands)
        return play.nodes_of(end) if hasattr(play, "nodes_of") else end

    exact = nodes(finest)
    size = float(np.ptp(exact[0], axis=1).max())
    return {
        each: float(np.median(np.linalg.norm(nodes(each) - exact, axis=1).max(axis=1)) / size)
        for each in parts
    }


def rate_of(play: Play, count: int, seconds: float) -> float:
    """Return samples a second of all robots together, in processor time."""
    samples, taken = 0, 0.0
    commands = commands_of(count, max(1, min(SAMPLES, MOST // count)))
    while taken < seconds:
        begin = process_time()
        play(commands)
        taken += process_time() - begin
        samples += count * len(commands)
    return samples / taken


if __name__ == "__main__":
    main()
