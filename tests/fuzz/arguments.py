"""Fuzzer of public arguments: one argument of a valid call is spoilt at a time.

``python -m tests.fuzz.arguments --count 100000 --processes 2`` calls so many times, prints each
find with the key that repeats it (``--repeat KEY``), and a table. ``--only NAME`` takes the names
that contain a text. The same seed gives the same calls. An outcome is one of ``OUTCOMES``; only the
first two may be.
"""

import argparse
import ast
import collections
import contextlib
import dataclasses
import dis
import functools
import inspect
import multiprocessing
import os
import random
import re
import sys
import tempfile
import threading
import time
import traceback
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

OUTCOMES = (
    "fine",
    "clear error",  # ours, and it names the argument
    "error without the name",  # ours
    "traceback from within",  # NumPy's, CasADi's, ...: nobody checked; or their warning
    "not finite",  # in what is returned, or in what is asked for afterwards
    "hang",
    "crash",  # the process died
)
PACKAGE = str(Path(__file__).parents[2] / "tenscontrol") + os.sep

# Seconds until a call hangs, and until a valid call with all that it needs is made.
LIMIT, PREPARATION = 10.0, 300.0

# Address space of a process that calls.
MEMORY = 4 * 2**30

# Left out: starts processes.
LEFT_OUT = {("sweep", "executor", "None")}

# Numbers that ask for a long motion or many outputs, or for one so fast that it takes many steps,
# as a million segments and compiling do: it takes its time, and can be interrupted. That is no
# hang.
LONG = (
    "1",
    "2",
    "7",
    "int8",
    "100",
    "1e6",
    "1e15",
    "2**31",
    "2**63",
    "uint64",
    "float32 max",
    "times 1e6",
)
FAST = ("1e6", "1e15", "1e100", "-1e100", "2**31", "2**63", "-2**63", "uint64", "float32 max")
FAST += ("times 1e6", "plus 1e9")
IN_MOTION = ("state", "held", "velocities", "external_force", "force_density", "rest_length")

# So many errors or times are each answered.
MANY = ("huge list", "array of a million")

# Functions that raise when they are called: that is their own error.
OWN_FUNCTIONS = ("class", "our class", "class of it", "lambda of it", "method")

# Other names that an error may use for an argument, which then says more than its own.
ALSO = {
    "integrate.Method.integrator|value": ("step", "tolerance"),
    # What has one entry for each of others: which of them is wrong, nobody can know.
    "Structure|bars": ("bar_mass",),
    "Structure|fixed": ("string_node_mass",),
    "dynamics.StringLaw.for_count|count": ("axial_rigidity",),
    "Winches.refuse_out_of_range|rest_length": ("winches",),
    "skin|panels": ("panel_mass", "areal_density"),
    "net|columns": ("fixed",),
    "net|rows": ("fixed",),
}

# Errors that tell what came of a call, rather than refuse an argument.
TOLD = {"SimulationError", "IntegrationError", "ShapeError", "PathError", "SweepError"}

# Figures of the replay of a planned motion, where there is one.
REPLAYED = (
    "cost_change", "goal_miss", "end_speed", "least_force_density", "peak_tension", "energy",
)  # fmt: skip

# Not finite, and documented as such.
MAY_BE_INFINITE = {
    "ConvergenceOrder.constant",
    "ConvergenceOrder.deviation",
    "ConvergenceOrder.order",
    "Fault.end",
    "FilterStatistics.normalized_innovation",
    "ReducedPlant.error_bound",
    "Ratios.least",
    "Ratios.ratio",
    "Ratios.time",
    "BaseController.bounds",
    "ShapeTarget.clearance",
    "ShapePath.clearance",
    "DemandCheck.high",
    "DemandCheck.low",
    "MPCSettings.longest_time",
    "MPCSettings.max_change",
    "MPCSettings.string_penalty",
    "OutputLimit.high",
    "OutputLimit.low",
    "Predictability.horizon",
    "Stepper.limits",
    "StringLaw.largest_force_density",
    *(f"{kind}.{name}" for kind in ("Mesh", "OptimalMotion") for name in REPLAYED),
}

# Returned as NaN or infinite, and documented so: an error that no run reaches, a reading that is
# lost, an error of a run that ended early, a margin without force.
MAY_BE_NAN = {
    "accuracy.WorkPrecision.fastest[1]",
    "accuracy.WorkPrecision.time_at",
    "Sensors.disturb",
    "Sensors.measure, tension",
    "fit.interval",
    "simulate_many.error",
    *(f"sizing.Sections.margins[{i}]" for i in range(2)),
}


# ---- one call ----


@functools.cache
def _calls():
    from tests.fuzz.valid_calls import CALLS

    return CALLS


@functools.cache
def _signature(name):
    """Parameters of a call with their defaults."""
    call = _calls()[name]
    return {
        key: each.default
        for key, each in inspect.signature(call.target()).parameters.items()
        if each.kind in (each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY)
    }


@functools.cache
def _spoilings(name, seed):
    """All ways to spoil a call, in an order that the seed gives: argument, whether whole, how."""
    from tests.fuzz import spoilers

    choose = random.Random(f"{seed}:{name}")
    given = _calls()[name].arguments()
    found = []
    for argument in dict.fromkeys([*given, *_signature(name)]):
        value = given.get(argument, _signature(name).get(argument))
        for spoiler in spoilers.WHOLE:
            if (name, argument, spoiler) in LEFT_OUT or _is_meant(name, argument, spoiler):
                continue
            if spoilers.is_replaced(value, None, spoiler):
                found.append((argument, True, spoiler))
        place = spoilers.place_of(value, choose)
        if place is not None:
            found += [
                (argument, False, spoiler)
                for spoiler in spoilers.ENTRY
                if spoilers.is_replaced(value, place, spoiler)
                and not _is_meant(name, argument, spoiler)
            ]
    choose.shuffle(found)
    return found


def _is_meant(name, argument, spoiler):
    """Whether a spoiler asks for what takes long, or gives a function that raises by itself."""
    runs = name.startswith("simulate") or ".advance" in name
    return (
        (argument == "duration" and spoiler in LONG)
        or (runs and argument in IN_MOTION and spoiler in FAST)
        or (runs and argument == "outputs" and spoiler in LONG)
        or (argument == "segments" and spoiler in ("1e6", "times 1e6"))
        or (name == "shape_path" and argument == "step" and spoiler == "1e-6")
        or (argument == "machine_code" and "True" in spoiler)
        or (argument in ("errors", "times") and spoiler in MANY)
        or (argument in ("report", "case", "controller") and spoiler in OWN_FUNCTIONS)
    )


def key_of(name, number, seed):
    """The key of a call of a name: what is spoilt, where and how; the name if nothing can be."""
    from tests.fuzz import spoilers

    found = _spoilings(name, seed)
    if not found:
        return name
    argument, whole, spoiler = found[number % len(found)]
    if whole:
        return f"{name}|{argument}||{spoiler}"
    value = _calls()[name].arguments()[argument]
    place = spoilers.place_of(value, random.Random(f"{seed}:{name}:{number}"))
    return f"{name}|{argument}|{place!r}|{spoiler}"


def outcome_of(key):
    """Make the call of a key, or the valid call of a name: (outcome, what was found)."""
    from tests.fuzz import spoilers

    name, *rest = key.split("|")
    call = _calls()[name]
    arguments = call.arguments()
    argument = None
    if rest:
        argument, place, spoiler = rest
        value = arguments.get(argument, _signature(name).get(argument))
        place = ast.literal_eval(place) if place else None
        arguments[argument] = spoilers.spoilt(value, place, spoiler)
    names = [argument, *ALSO.get(f"{name.split(',')[0]}|{argument}", ())]
    return judged(call.target(), arguments, names, name, call.after)


def judged(target, arguments, names, name, after=None):
    """Call, where an error may use any of the names: (outcome, what was found)."""
    with warnings.catch_warnings(record=True) as warned, _out_of_the_way():
        warnings.simplefilter("always")
        try:
            result = target(**arguments)
        except Exception as error:
            outcome = _kind_of_error(error, names)
        else:
            outcome = _kind_of_result(result, name, arguments)
        if outcome[0] in OUTCOMES[:3] and after is not None:
            try:
                found = not_finite(after(), "afterwards", set())
            except Exception as error:
                found = f"afterwards: {_last_line(error)}"
            if found:
                outcome = "not finite", found
    if outcome[0] in OUTCOMES[:3]:
        within = [str(each.message) for each in warned if _is_theirs(each)]
        if within:
            return "traceback from within", f"warning: {within[0]}"
    return outcome


def _kind_of_error(error, names):
    text = _last_line(error)
    last = error.__traceback__
    while last.tb_next is not None:
        last = last.tb_next
    code = last.tb_frame.f_code
    ours = code.co_filename.startswith(PACKAGE)
    raises = dis.opname[code.co_code[last.tb_lasti]] == "RAISE_VARARGS"
    where = f"{code.co_filename.removeprefix(PACKAGE)}:{last.tb_lineno}"
    is_clear = type(error) in (TypeError, ValueError) or type(error).__module__.startswith(
        "tenscontrol."
    )
    if isinstance(error, OSError) and (error.filename is not None or (ours and raises)):
        return "clear error", text  # of the system, with the path
    if not (ours and raises and is_clear):
        if not ours:
            frames = traceback.extract_tb(error.__traceback__)
            own = [f for f in frames if f.filename.startswith(PACKAGE)]
            where += (
                f" from {own[-1].filename.removeprefix(PACKAGE)}:{own[-1].lineno}" if own else ""
            )
        return "traceback from within", f"{where}: {text}"
    words = "|".join(str(each).replace("_", "[_ ]") for each in names)
    # In any case: a system says "File name too long".
    named = re.search(rf"(?<![A-Za-z0-9_])({words})(?![A-Za-z0-9_])", str(error), re.IGNORECASE)
    if named or type(error).__name__ in TOLD:
        return "clear error", text
    return "error without the name", f"{where}: {text}"


def _kind_of_result(result, name, arguments):
    given = {id(value) for value in arguments.values()}
    try:
        found = not_finite(result, name, given)
    except Exception as error:
        kind, text = _kind_of_error(error, [None])
        return (
            ("fine", "") if kind == "error without the name" else (kind, f"in the result: {text}")
        )
    return ("not finite", found) if found else ("fine", "")


def _last_line(error):
    lines = traceback.format_exception_only(error)
    return " ".join("".join(lines).split())[:400]


def _is_theirs(warning):
    """Whether a warning is NumPy's or SciPy's, rather than ours."""
    module = type(warning.message).__module__
    numeric = "encountered in|empty slice|Degrees of freedom|discards the imaginary|ill-conditioned"
    return module.startswith(("numpy", "scipy")) or re.search(numeric, str(warning.message))


@contextlib.contextmanager
def _out_of_the_way():
    """Run in a folder for scratch files, and close figures."""
    from tests.fuzz.valid_calls import folder

    before = Path.cwd()
    os.chdir(folder()[0])
    try:
        yield
    finally:
        os.chdir(before)
        if "matplotlib.pyplot" in sys.modules:
            sys.modules["matplotlib.pyplot"].close("all")


def not_finite(value, path, seen):
    """Where a value holds a number that is not finite, as text; "" if nowhere."""
    import numpy as np

    if isinstance(value, str | bytes | bool | int | np.bool_ | np.integer | type(None)):
        return ""
    if path in MAY_BE_NAN:
        return ""
    if isinstance(value, float | complex | np.inexact):
        return "" if np.isfinite(value) else f"{path} is {value}"
    if id(value) in seen:
        return ""
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        numeric = value.dtype.kind in "fc"
        return (
            f"{path} has {value[~np.isfinite(value)][0]}"
            if (numeric and not np.isfinite(value).all())
            else ""
        )
    if isinstance(value, tuple | list):
        return _first(not_finite(each, f"{path}[{i}]", seen) for i, each in enumerate(value))
    if isinstance(value, dict):
        return _first(
            not_finite(each, f"{path}[{i!r}]", seen)
            for i, each in value.items()
            if not (i in ("low", "high") and _is_bound(each))
        )
    cls = type(value)
    if cls.__module__.startswith("control."):
        return not_finite([value.A, value.B, value.C, value.D], path, seen)
    if cls.__module__.startswith("scipy.sparse"):
        return not_finite(value.data, path, seen)
    if cls not in _public_classes():
        return ""
    if cls.__name__ == "Batch":
        # Runs that ended alone are NaN from there on, and their messages say why.
        value = dataclasses.replace(
            value,
            **{
                name: None if array is None else array[value.completed]
                for name in ("nodes", "velocities", "command")
                for array in [getattr(value, name)]
            },
        )
    return _first(
        not_finite(getattr(value, name), f"{path}.{name}", seen)
        for name in _attributes(cls)
        if not any(f"{base.__name__}.{name}" in MAY_BE_INFINITE for base in cls.__mro__)
    )


@functools.cache
def _public_classes():
    from tests.public import public_classes

    return set(public_classes().values())


def _is_bound(value):
    """Whether a value is a bound: infinite where there is none, but never NaN."""
    import numpy as np

    return isinstance(value, float | np.ndarray) and not np.isnan(value).any()


def _first(found):
    return next((each for each in found if each), "")


@functools.cache
def _attributes(cls):
    """Public fields and properties of a class of ours."""
    if cls.__name__ in ("Model", "Equation", "ModeShape"):  # symbols; figures
        return ()
    names = [f.name for f in dataclasses.fields(cls)] if dataclasses.is_dataclass(cls) else []
    for base in cls.__mro__:
        if base.__module__.startswith("tenscontrol"):
            names += [
                name
                for name, member in vars(base).items()
                if isinstance(member, property | functools.cached_property)
            ]
    return tuple(dict.fromkeys(name for name in names if not name.startswith("_")))


# ---- processes ----


def _work(connection, memory):
    """Make calls on demand: the valid one first, then those that are asked for."""
    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # CasADi and progress bars write there
        os.dup2(silent, stream)
    cache = tempfile.TemporaryDirectory(prefix="fuzz-cache-")
    os.environ["XDG_CACHE_HOME"] = cache.name
    prepared = set()
    while True:
        try:
            name, number, seed = connection.recv()
        except EOFError:
            return
        if name not in prepared:
            connection.send(("valid", name, *outcome_of(name)))
            prepared.add(name)
        key = key_of(name, number, seed)
        connection.send(("begin", key))
        before = time.perf_counter()
        found = outcome_of(key)
        connection.send((*found, time.perf_counter() - before))


class Worker:
    """A process that makes calls, with a limit on the time of each. A lost one is replaced."""

    def __init__(self, limit=LIMIT):
        self.limit = limit
        self._process = None

    def _start(self):
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other, MEMORY), daemon=True)
        self._process.start()
        other.close()

    def stop(self):
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def ask(self, name, number, seed):
        """Finds, (key, outcome, text, seconds): of a call, and of the valid one if not fine."""
        if self._process is None:
            self._start()
        finds, key, until = [], name, PREPARATION
        try:
            self._pipe.send((name, number, seed))
            while True:
                if not self._pipe.poll(until):
                    self.stop()
                    return [*finds, (key, "hang", f"more than {until:g} s", until)]
                answer = self._pipe.recv()
                if answer[0] == "valid":
                    if answer[2] != "fine":
                        finds.append((name, answer[2], f"the valid call: {answer[3]}", 0.0))
                elif answer[0] == "begin":
                    key, until = answer[1], self.limit
                else:
                    return [*finds, (key, *answer)]
        except (EOFError, ConnectionError):
            self.stop()
            return [*finds, (key, "crash", "the process died", 0.0)]


def schedule(count, only="", least_share=0.0):
    """(name, number) of each call: names by how many arguments they have, and by their share."""
    calls = {
        name: call for name, call in _calls().items() if only in name and call.share >= least_share
    }
    weights = {
        name: call.share * max(len(_signature_cheap(name)), 0.05) for name, call in calls.items()
    }
    unit = count / sum(weights.values())
    drawn, carried = [], 0.0
    for name, weight in weights.items():
        carried += weight * unit
        take = round(carried)
        carried -= take
        drawn += [(name, number) for number in range(take)]
    return drawn


def _signature_cheap(name):
    """Parameters of a call, of the class or function itself: nothing is built."""
    from tests.public import members, public

    plain = name.split(",")[0]
    found = public().get(plain) or members()[plain][1]
    if plain in ("MPC", "NMPC"):
        from tests.fuzz.valid_calls import SETTINGS

        return SETTINGS
    found = found.__func__ if isinstance(found, classmethod) else found
    return [each for each in inspect.signature(found).parameters if each not in ("self", "cls")]


def run(count, seed=0, only="", processes=1, least_share=0.0, show=None, limit=LIMIT):
    """Make the calls, and return all finds: (key, outcome, text, seconds), in order of the key."""
    todo = iter(schedule(count, only, least_share))
    lock, finds = threading.Lock(), []

    def serve():
        worker = Worker(limit)
        try:
            while True:
                with lock:
                    item = next(todo, None)
                if item is None:
                    return
                for find in worker.ask(*item, seed):
                    with lock:
                        finds.append(find)
                        if show is not None:
                            show(find, len(finds))
        finally:
            worker.stop()

    with ThreadPoolExecutor(processes) as pool:
        for served in [pool.submit(serve) for _ in range(processes)]:
            served.result()
    return sorted(finds)


def table(finds):
    """Count of each outcome by folder, as text."""
    counts = collections.defaultdict(collections.Counter)
    for key, outcome, *_ in finds:
        for row in (_room(key.split("|")[0]), "all"):
            counts[row][outcome] += 1
    width = max(len(row) for row in counts)
    lines = [" " * width + "".join(f"  {outcome:>22s}" for outcome in OUTCOMES)]
    for row in sorted(counts, key=lambda row: (row == "all", row)):
        lines.append(f"{row:{width}s}" + "".join(f"  {counts[row][each]:22d}" for each in OUTCOMES))
    named, unnamed = counts["all"]["clear error"], counts["all"]["error without the name"]
    lines.append(f"{named / max(named + unnamed, 1):.2%} of the errors name the argument")
    return "\n".join(lines)


def _room(name):
    """The folder that a public name is of."""
    from tests.public import members, public

    plain = name.split(",")[0]
    owner = public().get(plain) or members()[plain][0]
    return owner.__module__.split(".")[1]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="names that contain this")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--repeat", metavar="KEY", help="one call, here, with its traceback")
    parser.add_argument("--verbose", action="store_true", help="print the clear errors too")
    given = parser.parse_args()
    if given.repeat:
        repeat(given.repeat)
        return 0
    sys.stdout.reconfigure(errors="backslashreplace")  # for surrogates in what is found

    def show(find, done):
        key, outcome, text, _ = find
        if given.verbose or outcome not in OUTCOMES[:2]:
            print(f"{outcome} --repeat '{key}' {text}", flush=True)
        if done % 1000 == 0:
            print(f"# {done} calls, {time.perf_counter() - start:.0f} s", file=sys.stderr)

    start = time.perf_counter()
    finds = run(given.count, given.seed, given.only, given.processes, show=show)
    print(table(finds))
    spent = collections.Counter()
    for key, _, _, seconds in finds:
        spent[key.split("|")[0]] += seconds
    slowest = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in spent.most_common(6))
    print(f"{len(finds)} calls, {time.perf_counter() - start:.0f} s; most time: {slowest}")
    return int(any(outcome not in OUTCOMES[:3] for _, outcome, *_ in finds))


def repeat(key):
    """Make one call, here, and print its outcome; what it raises comes with its traceback."""
    from tests.fuzz import spoilers

    name, *rest = key.split("|")
    outcome = outcome_of(key)
    print(*outcome, sep=": ")
    if outcome[0] == "fine" or not rest:
        return
    argument, place, spoiler = rest
    call = _calls()[name]
    arguments = call.arguments()
    value = arguments.get(argument, _signature(name).get(argument))
    place = ast.literal_eval(place) if place else None
    arguments[argument] = spoilers.spoilt(value, place, spoiler)
    print(f"{argument} = {arguments[argument]!r}"[:400])
    print(call.target()(**arguments))


if __name__ == "__main__":
    sys.exit(main())
