"""Kills of sweeps and compiles at random times: nothing is lost, and nothing is left.

``python -m tests.fuzz.kills --count 200`` sends SIGKILL, SIGTERM or SIGINT to a sweep with two
processes, and to a process that compiles, half of each, and prints what was wrong. After each:

- no worker and no compiler runs on after ten seconds; the longest time that one did is printed;
- the file of the sweep is resumed to the numbers of a sweep that nobody has killed;
- the library is compiled and loaded by the next process, with the same numbers, and no folder of
  the killed compile lasts.

It needs ``/proc`` and ``os.fork``. A few kills are in the ordinary suite, by ``test_kills.py``.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from contextlib import suppress
from pathlib import Path

import casadi as ca

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiled
from tests.robustness.cases import Inline

COUNT, SEED = 24, 3
PARAMETERS = {"mass": tc.Uniform(0.8, 1.2, size=3)}
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
MARK = "TENSCONTROL_KILLS"  # by this variable what a victim has started is found
LONGEST = 10.0  # s that anything may run on


def slow(parameters, rng):
    """A run of 20 ms, with a library that is compiled if it is not there."""
    time.sleep(0.02)
    value = float(machine()(parameters["mass"][0])) + rng.random()
    return tc.robustness.Outcome(success=value < 1.5, figures={"value": value})


def function(length=300):
    """Some work for a compiler: about half a second."""
    x = ca.SX.sym("x")
    y = x
    for i in range(length):
        y = ca.sin(y + i) + ca.exp(-(y**2))
    return ca.Function("work", [x], [y])


def machine(length=20):
    return compiled(function(length)).function


def sweep(file, **where):
    return tc.sweep(slow, PARAMETERS, COUNT, seed=SEED, file=file, **where)


def numbers(report):
    return [record.line() for record in report._records]


def victim(work, mark, folder):
    """Do the work in a process that was forked; return its id."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # until the child is within try
    process = os.fork()
    if process == 0:
        try:
            os.setsid()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
            quiet = os.open(os.devnull, os.O_RDWR)
            for stream in (1, 2):
                os.dup2(quiet, stream)
            os.environ |= {MARK: mark, "XDG_CACHE_HOME": str(folder)}
            work()
        finally:
            os._exit(0)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    return process


def left(mark):
    """What processes run that a victim has started, by their command."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has just ended
            if f"{MARK}={mark}".encode() in (place / "environ").read_bytes().split(b"\0"):
                found[int(place.name)] = (place / "cmdline").read_bytes().replace(b"\0", b" ")[:80]
    return found


def ended(process, mark):
    """Wait for the end of a victim and of all that it has started: seconds, and what is left."""
    began = time.monotonic()
    while time.monotonic() < began + LONGEST:
        if process is not None and os.waitpid(process, os.WNOHANG)[0]:
            process = None
        if process is None and not left(mark):
            return time.monotonic() - began, {}
        time.sleep(0.02)
    return LONGEST, left(mark) | ({process: b"the victim"} if process else {})


def strike(work, rng, longest, mark, folder):
    """Do the work, and send a signal at a random time; return seconds to the end and faults."""
    number = rng.choice(SIGNALS)
    process = victim(work, mark, folder)
    time.sleep(rng.uniform(0.0, longest))
    os.kill(process, number)
    seconds, running = ended(process, mark)
    for each in running:
        os.kill(each, signal.SIGKILL)
    return number.name, seconds, [f"{each!r} runs on" for each in running.values()]


def struck_sweep(rng, mark, folder, whole):
    file = folder / "runs.jsonl"
    name, seconds, faults = strike(lambda: sweep(file, processes=2), rng, 4.0, mark, folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a torn line
        if file.exists() and numbers(sweep(file, executor=Inline())) != whole:
            faults.append("other numbers")
    return name, seconds, faults


def struck_compile(rng, mark, folder):
    name, seconds, faults = strike(lambda: compiled(function()), rng, 1.5, mark, folder)
    cache = folder / "tenscontrol"
    for each in cache.glob("making-*"):
        os.utime(each, (0.0, 0.0))  # as if this were ten seconds later
    expected = float(function()(0.3))
    if float(compiled(function()).function(0.3)) != expected:
        faults.append("other numbers")
    faults += [f"{each.name} is left" for each in cache.iterdir() if each.suffix != ".so"]
    return name, seconds, faults


def kill(count, seed=0):
    """Kill so many times; return how often each, the longest time to the end, and what is wrong."""
    done, longest, wrong = Counter(), 0.0, []
    cache = os.environ.get("XDG_CACHE_HOME")
    with tempfile.TemporaryDirectory() as place:
        os.environ["XDG_CACHE_HOME"] = place
        whole = numbers(sweep(None, executor=Inline()))
        for number in range(count):
            rng, mark = random.Random(f"{seed} {number}"), f"{os.getpid()}-{number}"
            folder = Path(place) / str(number)
            folder.mkdir()
            os.environ["XDG_CACHE_HOME"] = str(folder)
            if number % 2:
                what, struck = "sweep", struck_sweep(rng, mark, folder, whole)
            else:
                what, struck = "compile", struck_compile(rng, mark, folder)
            name, seconds, faults = struck
            done[f"{name} of a {what}"] += 1
            longest = max(longest, seconds)
            wrong += [f"{number}, {name} of a {what}: {fault}" for fault in faults]
    del os.environ["XDG_CACHE_HOME"]
    if cache is not None:
        os.environ["XDG_CACHE_HOME"] = cache
    return done, longest, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    done, longest, wrong = kill(asked.count, asked.seed)
    print(*wrong, sep="\n")
    for what, count in sorted(done.items()):
        print(f"{count:6d}  {what}")
    print(f"{asked.count} kills: {len(wrong)} faults; all ended within {longest:.2f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
