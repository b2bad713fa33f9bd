"""Ctrl-C and SIGTERM at random times in every long loop: what is done comes back, within a second.

``python -m tests.fuzz.interrupts --count 1000`` runs the whole campaign and prints, for each loop,
how often it was interrupted, how often before anything was done, and the longest wait for control
after the signal. It ends with status 1 if a motion was lost, a record does not fit its motion, a
run cannot be gone on from, a handler, a process or a file is left behind, or control was not back
within the time allowed. POSIX only.
"""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.measured_run import Bench
from tenscontrol.accuracy.predictability import predictability
from tenscontrol.interrupt import InterruptionWarning, interruptible
from tenscontrol.robustness import store
from tenscontrol.simulation import plant_run
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.robustness.cases import PARAMETERS, Inline, brief

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "examples" / "scenes"
SAMPLE = 0.02
LONG = 1e4  # s of motion: more than is computed before the signal

# s, from the signal to control: of a machine that does nothing else, and of ours.
PROMISED, ALLOWED = 1.0, 10.0

# Sends signals from outside, however busy Python is, and says when.
SENDER = """
import os, sys, time
for line in sys.stdin:
    delay, number = line.split()
    time.sleep(float(delay))
    # Both clocks are the system's.
    print(time.monotonic(), flush=True)
    os.kill(os.getppid(), int(number))
"""


class LostError(AssertionError):
    """Something that was done did not come back, or something stayed behind."""


# ---- what is run ----


@cache
def example():
    """The prism: oscillating in open loop, and with controllers at rest."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    rest = tc.prestress(prism, force_density=17.3205)
    force = tc.linearize(model, rest)
    held = tc.linearize(model, rest, input="rest_length")
    Q, R = tc.energy_weights(force)
    return SimpleNamespace(
        model=model,
        lengths=rest_lengths(prism, paper_force_density(9.0), 100.0),
        held=held,
        nodes=held.to_nodes(0.01 * np.random.default_rng(0).normal(size=9)),
        lqr=tc.LQR(force, Q, 0.1 * R, sample_time=SAMPLE, max_force_density=90.0),
        mpc=tc.MPC(held, sample_time=SAMPLE, horizon=20),
        nmpc=tc.NMPC(held, sample_time=SAMPLE, horizon=10),
    )


@cache
def estimator():
    """A Kalman filter of late, noisy measurements."""
    sensors = tc.Sensors(
        structure=example().model.structure, delay=2, string_length=1e-3, bar_direction=1e-2,
        node_position=2e-3,
    )  # fmt: skip
    return tc.KalmanFilter(example().held, sensors, sample_time=SAMPLE)


def open_loop(method, **options):
    """Return an oscillation of the prism."""
    given = {"method": method, "rest_length": example().lengths, "output_step": 0.01, **options}
    return lambda: tc.simulate(example().model, LONG / 10, **given)


def closed_loop(name, estimated=False):
    """Return a run of the prism under a controller."""

    def run():
        it = example()
        return tc.simulate(
            it.model, LONG, it.nodes, controller=getattr(it, name), step=5e-3, output_step=SAMPLE,
            rest_length=it.held.rest_length, estimator=estimator() if estimated else None,
        )  # fmt: skip

    return run


def case(duration=1.0):
    """Return the case of the accuracy reports."""
    value = paper_force_density(9.0)
    return tc.Scene(tc.Model(tc.prism()), duration, force_density=value)


@cache
def study():
    """Return the stiffness study, whose module may not be interrupted while it is imported."""
    from examples.stiffness_study import stiffness_report

    return partial(stiffness_report, tc.prestress(tc.prism(), force_density=17.3205))


def stiffness():
    """Return the report of the stiffness study."""
    return study()(
        np.geomspace(1e2, 1e3, 40), sample_time=SAMPLE, duration=0.1, horizon=3,
        damping=1.0,
    )  # fmt: skip


MOTIONS = {
    "rk4": open_loop("rk4", step=1e-4),
    "dop853": open_loop("dop853", tolerance=1e-13),
    "cvodes": open_loop("cvodes", tolerance=1e-9),
    "energy_momentum": open_loop("energy_momentum", step=1e-3),
    "LQR": closed_loop("lqr"),
    "MPC": closed_loop("mpc"),
    "NMPC": closed_loop("nmpc"),
    "MPC with estimator": closed_loop("mpc", estimated=True),
}

REPORTS = {
    "work_precision": lambda: tc.work_precision(case(30.0), ["rk4", "dop853"], repeats=50),
    "convergence_order": lambda: tc.convergence_order(
        case(100.0), "rk4", list(np.geomspace(1e-2, 1e-4, 60))
    ),
    "long_run": lambda: tc.long_run(case(), "rk4", 1e-3, steps=10_000_000, outputs=20_000),
    "stability_map": lambda: tc.stability_map("rk4", np.geomspace(1e2, 1e4, 50), [0.1], steps=100),
    "predictability": lambda: predictability(case(200.0), error=1e9, outputs=20_000),
    "stiffness_report": stiffness,
}

# Where the runs of a sweep are done, and until when the signal comes, s.
SWEEPS = {
    "sweep on threads": (lambda: ThreadPoolExecutor(2), 0.5),
    "sweep on processes": (lambda: nullcontext(None), 4.0),
}
FIRST = 10  # runs of a sweep that are done again

# The command, what tells that it has begun, and whether it draws figures after the signal.
COMMANDS = {
    "demo": (["demo", "--no-figures", "--output", "out"], "tenscontrol", False),
    "demo with figures": (["demo", "--output", "out"], "tenscontrol", True),
    "simulate": (["simulate", str(SCENES / "prism_mpc.toml"), "--output", "out"], None, True),
    "accuracy": (["accuracy", str(SCENES / "prism_free.toml"), "--output", "out"], None, True),
}


# ---- one interrupt ----


class Sender:
    """A process that sends this one a signal after a time."""

    line = None  # what it said when it had sent it

    def __enter__(self):
        self.process = subprocess.Popen(
            [sys.executable, "-S", "-c", SENDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, start_new_session=True,
        )  # fmt: skip
        return self

    def __exit__(self, *_):
        self.process.communicate()

    def send(self, delay, number):
        """Have a signal sent so much later, s."""
        self.process.stdin.write(f"{delay} {int(number)}\n")
        self.process.stdin.flush()

    def sent(self):
        """Wait until it was sent, and return when; asked again after an interrupt, the same."""
        if self.line is None:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
            try:
                self.line = self.process.stdout.readline()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        line, self.line = self.line, None
        return float(line)


class Begun:
    """Counts what loops have done, so that it is known whether something could be returned."""

    def __init__(self):
        self.count = 0
        for owner, name in ((plant_run, "RunSpan"), (Bench, "_judged")):
            self._watch(owner, name)

    def _watch(self, owner, name):
        original = getattr(owner, name)

        def counted(*arguments):
            found = original(*arguments)
            self.count += 1
            return found

        setattr(owner, name, counted)


def check_motion(run):
    """Raise if a motion that was interrupted is not whole in itself, or cannot be gone on from."""
    count = len(run.time)
    if run.stopped is None or "interrupted" not in run.stopped:
        raise LostError(f"stopped is {run.stopped!r}")
    for name in ("nodes", "velocities", "force_density", "kinetic_energy", "momentum"):
        part = getattr(run, name)
        if part.shape[-1] != count or not np.isfinite(part).all():
            raise LostError(f"{name} has shape {part.shape} for {count} times, or is not finite")
    if (np.diff(run.time) <= 0).any():
        raise LostError("times do not ascend")
    record = run.control
    if record is not None:
        samples = len(record.time)
        parts = [record.status, record.command.T, record.applied.T, record.computing_time]
        if record.estimate is not None:
            parts += [record.estimate.status, record.estimate.nodes.T]
        if {len(part) for part in parts} != {samples}:
            raise LostError(
                f"the record has {[len(part) for part in parts]} entries, {samples} times"
            )
        if record.time[-1] > run.time[-1] + 1e-9:
            raise LostError("a sample is recorded that begins after the motion")


def go_on(name, run):
    """Go on from an interrupted run for two samples."""
    it = example()
    if run.control is None:
        setting = {run.choice.setting: run.choice.value}
        tc.simulate(it.model, 0.02, start=run, method=run.method, **setting)
        return
    controller = getattr(it, name.split()[0].lower())
    options = {"estimator": estimator()} if run.control.estimate is not None else {}
    more = tc.simulate(it.model, 2 * SAMPLE, start=run, controller=controller, step=5e-3, **options)
    if len(more.control.time) != 2:
        raise LostError(f"it went on for {len(more.control.time)} samples")


def interrupt(name, sender, begun, delay, number):
    """Interrupt one loop once; return the wait for control, s, and whether anything was done."""
    run = {**MOTIONS, **REPORTS}[name]
    begun.count = 0
    back, found, said = signalled(run, sender, delay, number)
    if found is None:
        if name in MOTIONS and begun.count:
            raise LostError("there was a motion, and KeyboardInterrupt came in its place")
        if name in ("work_precision", "convergence_order") and begun.count:
            raise LostError(
                f"{begun.count} rows were done, and KeyboardInterrupt came in their place"
            )
        return back, False
    if InterruptionWarning not in said:
        raise LostError(f"no warning tells of it: {said}")
    if name in MOTIONS:
        check_motion(found)
        with warnings.catch_warnings(action="ignore"):
            go_on(name, found)
    else:
        (getattr(found, "table", None) or found.summary)()
    return back, True


def signalled(run, sender, delay, number):
    """Run, with a signal on the way; return the wait for control, s, what came, and warnings."""
    found, said = None, []
    # SIGTERM outside of a loop would end this process.
    guard = interruptible() if number == signal.SIGTERM else nullcontext()
    try:
        with guard, warnings.catch_warnings(record=True, action="always") as said:
            faulthandler.dump_traceback_later(delay + ALLOWED / 2)  # where it is held up
            sender.send(delay, number)
            found = run()
            back = time.monotonic()
            sent = sender.sent()
    except KeyboardInterrupt:
        back = time.monotonic()
        sent = sender.sent()
    except Exception as error:
        with suppress(KeyboardInterrupt):
            sender.sent()
        sender.line = None  # it is not that of the next signal
        raise LostError(f"{type(error).__name__}: {error}") from error
    finally:
        faulthandler.cancel_dump_traceback_later()
    if back < sent:
        with suppress(KeyboardInterrupt):
            time.sleep(1)
        raise LostError("the loop ended by itself: it is to be longer")
    if number == signal.SIGTERM:
        with suppress(SystemExit), interruptible():
            raise LostError("a loop began after SIGTERM")
    for each, usual in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGTERM, signal.SIG_DFL),
    ):
        if signal.getsignal(each) is not usual:
            raise LostError(f"the handler of {each} is {signal.getsignal(each)}")
    return back - sent, found, [each.category for each in said]


@cache
def alone():
    """Return the first runs of the sweep, which nobody interrupts."""
    return numbers(tc.sweep(brief, PARAMETERS, FIRST, seed=0, executor=Inline()))


def numbers(report):
    return list(report._records)


def interrupt_sweep(name, sender, delay, number):
    """Interrupt a sweep once; return the wait for control, s, and whether any run was done."""
    make, _ = SWEEPS[name]
    alone()
    with tempfile.TemporaryDirectory() as folder, make() as executor:
        file = Path(folder) / "runs.jsonl"
        where = {"processes": 2} if executor is None else {"executor": executor}
        wait, found, said = signalled(
            lambda: tc.sweep(brief, PARAMETERS, 1_000_000, seed=0, file=file, **where),
            sender, delay, number,
        )  # fmt: skip
        if multiprocessing.active_children():
            raise LostError("a worker is left")
        is_begun = file.exists() and file.stat().st_size > 0  # a new file is empty at first
        done = list(store.read(file)[1].values()) if is_begun else []
        if found is None:
            if done:
                raise LostError(f"{len(done)} runs were done, and KeyboardInterrupt came instead")
        elif said != [RuntimeWarning]:
            raise LostError(f"no warning tells of it, or others too: {said}")
        elif numbers(found) != done:
            raise LostError(f"the report has {len(found)} runs, its file {len(done)}")
        if numbers(tc.sweep(brief, PARAMETERS, FIRST, seed=0, file=file, executor=Inline())) != (
            alone()
        ):
            raise LostError("other numbers after it went on")
    return wait, found is not None


def interrupt_command(name, delay, number):
    """Interrupt the command line once; return the wait for its end, s, and whether it drew."""
    arguments, first, draws = COMMANDS[name]
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [sys.executable, "-m", "tenscontrol", *arguments], cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
            env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        try:
            if first is not None:
                if not process.stdout.readline().startswith(first):
                    raise LostError("it did not begin")
            else:
                while not (Path(folder) / "out").exists() and process.poll() is None:
                    time.sleep(0.01)
                    if name == "accuracy":  # its folder is made at the end
                        time.sleep(2.5)
                        break
            time.sleep(delay)
            sent = time.monotonic()
            process.send_signal(number)
            out, error = process.communicate(timeout=120)
            back = time.monotonic()
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, 0)
            raise LostError("a process of the command is left")
        if process.returncode == 0:
            return 0.0, False  # it was over
        # Python ends itself by SIGINT, 130 to a shell as well, if KeyboardInterrupt has passed
        # through the exec of a text, as dataclasses are made: whoever has caught it.
        if process.returncode not in (128 + number, -signal.SIGINT):
            raise LostError(f"status {process.returncode}, said {error!r}")
        if error != "tenscontrol: interrupted; what is above was done by then\n":
            raise LostError(f"said {error!r}")
        if name == "simulate" and "ended early" in out and not list(Path(folder).rglob("*.npz")):
            raise LostError("the motion is not saved")
    return (0.0 if draws else back - sent), True


# ---- the campaign ----


def campaign(count, seed=0, commands=True, told=print):
    """Interrupt loops so many times; return the failures, and the longest wait of all, s."""
    generator = np.random.default_rng(seed)
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    kept = {(owner, name): getattr(owner, name)
            for owner, name in ((plant_run, "RunSpan"), (Bench, "_judged"))}  # fmt: skip
    waits, nothing, failures = defaultdict(list), defaultdict(int), []
    example(), study()
    try:
        begun = Begun()
        with Sender() as sender:
            for i in range(count):
                if i and i % 50 == 0:
                    longest = max(map(max, waits.values()))
                    told(f"{i} done, {len(failures)} failures, at most {longest:.3f} s")
                names = [*MOTIONS] * 3 + [*REPORTS]
                if commands and i % 20 in (9, 19):
                    names = [*COMMANDS] if i % 20 == 19 else [*SWEEPS]
                name = str(generator.choice(names))
                number = signal.SIGTERM if generator.random() < 0.25 else signal.SIGINT
                latest = SWEEPS[name][1] if name in SWEEPS else 0.5 if name in MOTIONS else 1.5
                delay = float(generator.uniform(0.002, latest))
                try:
                    if name in COMMANDS:
                        wait, done = interrupt_command(name, delay, number)
                    elif name in SWEEPS:
                        wait, done = interrupt_sweep(name, sender, delay, number)
                    else:
                        wait, done = interrupt(name, sender, begun, delay, number)
                except LostError as error:
                    failures.append(f"{i}: {name} after {delay:.4f} s by {number.name}: {error}")
                    told(failures[-1])
                    continue
                waits[name].append(wait)
                nothing[name] += not done
                if wait > ALLOWED:
                    failures.append(f"{i}: {name} after {delay:.4f} s: {wait:.2f} s to control")
                    told(failures[-1])
    finally:
        for (owner, name), original in kept.items():
            setattr(owner, name, original)
        for each, handler in before.items():
            signal.signal(each, handler)
    for name, found in sorted(waits.items()):
        told(
            f"{name:20s} {len(found):4d} interrupts, {nothing[name]:3d} before anything was done; "
            f"control after {1e3 * np.median(found):6.1f} ms, at most {1e3 * max(found):6.1f} ms"
        )
    return failures, max(max(found) for found in waits.values())


def main(arguments=None):
    """Run the campaign, and return 1 if anything was lost."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.interrupts", description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-commands", action="store_true", help="loops within one process only")
    options = parser.parse_args(arguments)
    began = time.monotonic()
    failures, longest = campaign(options.count, options.seed, not options.no_commands)
    print(
        f"{options.count} interrupts, {time.monotonic() - began:.0f} s, {len(failures)} failures; "
        f"control back after {longest:.3f} s at most (promised {PROMISED:g} s)"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
