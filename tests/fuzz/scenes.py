"""Scene files spoilt at random: each is loaded and run for a moment, or refused in plain words.

    python -m tests.fuzz.scenes --count 20000 [--seed 0] [--processes 2] [--minutes 10]

Each file is one of those that ship, or one with every table, with one to three places changed. A
child process loads it, under a limit of memory; the parent ends the child if it takes too long. An
outcome is good if the scene loads, or if an error of our own names the file. What is not good is
printed with the number that makes the same file again: ``--only NUMBER``.
"""

import argparse
import importlib
import json
import linecache
import queue
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from tests.scene.limits import limits

PROJECT = Path(__file__).parent.parent.parent
SHIPPED = sorted((PROJECT / "examples" / "scenes").glob("*.toml"))

# What no shipped scene has.
MEMBERS = """\
[structure]
nodes = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]
bars = [[1, 2]]
strings = [[0, 1], [2, 3]]
bar_mass = [2.0]
string_groups = ["left", "right"]
fixed = [0, 3]
[loads]
gravity = [0.0, 0.0, 0.0]
[[loads.forces]]
node = 1
force = [0.1, 0.0, 0.0]
[prestress]
force_density = {left = 10.0, right = 10.0}
[start]
velocities = [[0, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 0]]
[run]
duration = 0.1
method = "dop853"
output_step = 0.01
input = "force_density"
tolerance = 1e-7
"""
EVERY = """\
[structure]
generator = "prism"
sides = 3
handedness = "right"
diagonals = true
top_radius = 0.4
[skin]
panels = ["top", [3, 4, 5]]
iterations = 1
panel_mass = 0.02
[subdivide]
segments = 2
node_mass = 0.001
[strings]
law = "elastic"
axial_rigidity = 300.0
damping = {top = 1.0, bottom = 1.0, vertical = 1.0, diagonal = 1.0, skin = 0.1}
per = "string"
[prestress]
force_density = 20.0
reference = "vertical"
[start]
disturbance = 0.001
[run]
duration = 0.2
step = 1e-3
method = "rk4"
"""
LOOP = """\
[structure]
generator = "prism"
[strings]
law = "linear"
stiffness = 200.0
damping = 0.5
[prestress]
force_density = 17.3205
[start]
disturbance = 0.01
[run]
duration = 0.3
step = 2e-3
[controller]
kind = "lqr"
input = "rest_length"
sample_time = 0.02
Q = 1.0
R = 1.0
max_change = 0.1
[winches]
rate = {top = 1.0, bottom = 1.0, vertical = 2.0}
longest = 3.0
ramp = true
substeps = 2
[sensors]
string_length = [0.001, 0.002, 0.001]
strings = [0, 4, 8]
bar_direction = 0.01
bars = [0, 1, 2]
node_position = 0.01
nodes = [1]
string_tension = 0.5
tension_strings = [2]
delay = 1
outlier_rate = 0.01
[estimator]
kind = "kalman"
process_noise = 0.03
prediction = "nonlinear"
gate = 1e-5
patience = 6
start_spread = 0.02
[[faults]]
kind = "cut_string"
string = 8
time = 0.1
"""
PREDICTIVE = f"""\
[structure]
generator = "prism"
[strings]
law = "linear"
stiffness = 200.0
[prestress]
force_density = 17.3205
[run]
duration = 0.1
step = 2e-3
[controller]
kind = "nmpc"
input = "rest_length"
horizon = 2
sample_time = 0.02
max_iterations = 100
{limits(0.9)[0]}"""
SHAPE = """\
[structure]
generator = "prism"
[prestress]
force_density = 17.3205
[run]
duration = 0.1
step = 2e-3
sample_time = 0.01
[controller]
kind = "feedback_linearization"
frequency = 1.0
damping = 1.0
min_force_density = 1.0
max_force_density = 60.0
"""
PLANE = """\
[structure]
nodes = [[0, 0], [1, 0], [1, 1], [0, 1]]
bars = [[0, 1], [1, 2]]
strings = [[2, 3], [0, 3, 2], [0, 2]]
bar_mass = 1.0
point_mass = [0, 0, 0.5, 0.2]
fixed = [0, [1, "y"]]
string_groups = ["side", "over", "side"]
[strings]
law = "linear"
stiffness = 100.0
[loads]
gravity = [0.0, -1.0]
forces = [{node = 2, force = [0.1, 0.0]}]
[prestress]
force_density = {side = 3.0, over = 2.0}
[start]
disturbance = 0.001
[run]
duration = 0.05
step = 1e-3
"""
GROUNDED = """\
[structure]
generator = "snelson_x"
[strings]
law = "linear"
stiffness = 200.0
[loads]
gravity = 9.81
[prestress]
force_density = 10.0
[ground]
stiffness = 1e3
damping = 0.1
friction = 0.5
height = -0.6
nodes = [0, 1, 2]
[run]
duration = 0.05
step = 1e-3
"""
# Those that take a second each are taken less often.
_SLOW = {"prism_morph": 1, "prism_fault": 1, "prism_mpc": 4, "prism_standing": 5, "ball_drop": 1}
# Most without comments, where a change changes nothing.
SOURCES = [
    (re.sub(r" *#.*", "", file.read_text(encoding="utf-8")), _SLOW.get(file.stem, 8))
    for file in SHIPPED
]
SOURCES.append((SHIPPED[0].read_text(encoding="utf-8"), 1))
SOURCES += [
    (MEMBERS, 12),
    (PLANE, 8),
    (EVERY, 8),
    (LOOP, 3),
    (PREDICTIVE, 2),
    (SHAPE, 4),
    (GROUNDED, 8),
]


def _words(text):
    return text.split()


NUMBERS = _words(
    """0 -0.0 1 -1 2 3 4 7 10 12 20 100 1000 100000 1000000 10000000 2147483647 2147483648
4294967296 9007199254740993 9223372036854775807 9223372036854775808 1e-5 1e-12 1e-30 1e-200
5e-324 0.5 0.999999 1.5 1e3 1e6 1e9 1e15 1e29 1e30 1e70 1e150 1e154 1e155 1e300 1.7e308 1e309
-1e300 nan inf -inf -5 -2.5 1e999 0x7fffffff 0b11 1_000 +3 007
"""
)
NUMBERS += ["1" + "0" * 400, "9" * 5000, "-1" + "0" * 30, "0." + "0" * 400 + "1"]
WORDS = _words(
    r""""" "x" "prism" "python" "laws.py:hold" "no.such.module:hold"
"mpc" "nmpc" "lqr" "feedback_linearization" "rest_length" "linear" "top"
"force_density" "elastic" "kalman" "sides" "vertical" "a\u0000b" "\U0001F600" 'über' "rk4"
"dop853" "cvodes" "energy_momentum" "gauss4" "auto" "string" "segment"
"nonlinear" "stages" "osqp" "explicit" "z" "cut_string" "stuck_winch" "lost_measurement"
true false [] {} [[]] [0] [0,0,0] [1,2,3] [[0,0,0]] [nan] [1e300,1,2] [true] [""] [[1],[2,3]]
1979-05-27 07:32:00 1979-05-27T07:32:00Z {top=1} {a.b=1} {top=1,bottom=1,vertical=1} [{node=0}]
[0,1,2,3] [-1] [99] [0.5] [[0,1]] [[0,1],[1,2],[2,0]] [1e-300,0,0] {top={}}
"""
)
LINES = _words(
    """[structure] [run] [controller] [[faults]] [[run]] [a] [a.b.c] [loads] [skin] [[structure]]
[prestress.force_density] x=1 =1 [ ] [] [[]] key "a"=1 ключ=1 "ключ"=1 ʎ.z=1 sides=3 duration=1
[controller.reference] [[controller.reference]] [[controller.outputs]] time=1.0 height=0.9 #
start=0.1 twist=0.1 shape_gives=true gravity=9.81 fixed=[0] seed=3
method="cvodes" tolerance=1e-3 output_step=1e-9 segments=100000 iterations=12 horizon=5000
per="string" delay=100 bar_mass=1e-9 radius=1e-9 height=1e20 stiffness=1e15 damping=1e9
kind="hertz" kind="smooth" width=0.1 friction=5 slip_speed=1e-9 normal=[0,0,1] [ground] [[ground]]
sample_time=1e-7 function="laws.py:hold" factory="no.such.module:make" settings={gain=1.0}
"""
)
_NUMBER = re.compile(r"(?<![\w\"'.+-])[+-]?\d[\d_.]*(?:e[+-]?\d+)?(?![\w\"'.-])")
_VALUE = re.compile(r"(?m)^(\s*[\w.]+ *= *)([^#\n]+)")


def spoilt(number, seed=0):
    """The bytes of one spoilt scene file."""
    rng = random.Random(f"{seed}-{number}")
    texts, weights = zip(*SOURCES, strict=True)
    text = rng.choices(texts, weights)[0]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        text = rng.choices(*zip(*_CHANGES, strict=True))[0](rng, text)
    raw = text.encode("utf-8", "surrogatepass")
    return _broken_bytes(rng, raw) if rng.random() < 0.05 else raw


def _another_number(rng, text):
    return _replaced(rng, text, _NUMBER, lambda found: rng.choice(NUMBERS))


def _nearby_number(rng, text):
    def near(found):
        try:
            value = float(found.group())
        except ValueError:
            return "0"
        return repr(value * 10.0 ** rng.uniform(-12, 12) * rng.choice((1, 1, -1)))

    return _replaced(rng, text, _NUMBER, near)


def _another_value(rng, text):
    return _replaced(rng, text, _VALUE, lambda found: found.group(1) + rng.choice(WORDS + NUMBERS))


def _replaced(rng, text, pattern, change):
    found = list(pattern.finditer(text))
    if not found:
        return text
    place = rng.choice(found)
    return text[: place.start()] + change(place) + text[place.end() :]


def _without_line(rng, text):
    lines = text.splitlines(keepends=True)
    del lines[rng.randrange(len(lines)) if lines else slice(0)]
    return "".join(lines)


def _another_line(rng, text):
    lines = text.splitlines(keepends=True)
    new = rng.choice(LINES) + "\n" if rng.random() < 0.7 else rng.choice(lines or [""])
    lines.insert(rng.randint(0, len(lines)), new)
    return "".join(lines)


def _swapped_values(rng, text):
    found = list(_VALUE.finditer(text))
    if len(found) < 2:
        return text
    a, b = sorted(rng.sample(found, 2), key=lambda match: match.start())
    parts = text[: a.start(2)], b.group(2), text[a.end(2) : b.start(2)], a.group(2)
    return "".join(parts) + text[b.end(2) :]


def _another_sign(rng, text):
    place = rng.randint(0, len(text))
    sign = rng.choice("[]{}=,.\"'#\n\\\t -+_0e\0\x7f\u2028\ufeff\udc80é𝛾")
    return text[:place] + sign + text[place + rng.randint(0, 2) :]


def _cut_off(rng, text):
    return text[: rng.randint(0, len(text))]


def _huge(rng, text):
    """Something that is long, deep, or much of one kind, of a size drawn at random."""
    many = int(10 ** rng.uniform(1, 5.3))
    value = rng.choice(
        (
            "[" * many + "]" * many,
            "[" * many,
            "{a=" * many + "1" + "}" * many,
            "[" + "[0,0,0]," * many + "]",
            "[" + "1.5," * many + "]",
            "[" + "{}," * many + "]",
            "9" * many,
            '"' + "x" * many + '"',
            "[" + '"top",' * many + "]",
        )
    )
    line = rng.choice(
        (
            f"key = {value}\n",
            f"nodes = {value}\n",
            "a." * many + "b = 1\n",
            "[" + "a." * many + "b]\n",
            "".join(f"k{i} = {i}\n" for i in range(many)),
            "".join(f"[t{i}]\n" for i in range(many)),
            "[[faults]]\n" * many,
            "[[controller.reference]]\ntime=1.0\n" * many,
            "#" + "=" * many + "\n",
            "\n" * many,
        )
    )
    if rng.random() < 0.5:
        return _replaced(rng, text, _VALUE, lambda found: found.group(1) + value)
    lines = text.splitlines(keepends=True)
    lines.insert(rng.randint(0, len(lines)), line)
    return "".join(lines)


_CHANGES = (
    (_another_number, 10),
    (_nearby_number, 10),
    (_another_value, 10),
    (_without_line, 4),
    (_another_line, 8),
    (_swapped_values, 3),
    (_another_sign, 4),
    (_cut_off, 1),
    (_huge, 2),
)


def _broken_bytes(rng, raw):
    place = rng.randint(0, len(raw))
    return rng.choice(
        (
            raw[:place] + bytes([rng.randrange(256)]) + raw[place:],
            raw[:place] + b"\0" * rng.randint(1, 5) + raw[place:],
            b"\xef\xbb\xbf" + raw,
            raw.decode("utf-8", "replace").encode("utf-16"),
            raw.decode("utf-8", "replace").encode("latin-1", "replace"),
            raw.replace(b"\n", b"\r\n"),
            raw.replace(b"\n", b"\r"),
            b"",
            bytes(rng.randrange(256) for _ in range(200)),
        )
    )


# ---- what becomes of a file ----

# What the files of others may raise within a read: their errors are handed on in our words.
_READERS = ("tomllib", "codecs", "encodings", "pathlib")


# How long a motion may take before it is interrupted, s.
PATIENCE = 3.0


def outcome(file, run=False):
    """Load a file, and run it for a moment; what became of it, and the message if refused."""
    import tenscontrol as tc
    from tenscontrol.simulation import SimulationError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # accuracy is not in question
        try:
            scene = tc.load_scene(file, allow_code=True)  # of files and modules that are not there
        except Exception as error:
            return _judged(error, str(file))
        size = scene.nodes.shape[1]
        if run and size < LARGE:
            sample = scene.sample_time or getattr(scene.controller, "sample_time", None) or 0.0
            moment = max(sample, 2 * (scene.integration.step or 0.0)) or 1e-3 * scene.duration
            # A stiff scene may take long for a moment: it is interrupted, as a user would.
            signal.setitimer(signal.ITIMER_REAL, PATIENCE)
            try:
                replace(scene, duration=min(scene.duration, moment)).simulate()
            except (SimulationError, KeyboardInterrupt) as error:
                return "ran away", str(error), size
            except Exception as error:
                return *_judged(error, "")[:2], size
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            return "ran", "", size
        return "loaded", "", size


# Nodes of a scene that may take its time.
LARGE = 300

# MB after which the next scene gets a child of its own.
HELD = 300.0


def _judged(error, file):
    """Whether an error was raised by a check of ours and says where it belongs."""
    from tenscontrol.scene import SceneError

    message = f"{type(error).__name__}: {error}"
    if not isinstance(error, ValueError | TypeError | OSError):
        return "uncaught", _with_place(error, message), 0
    cause = error.__cause__ if isinstance(error, SceneError) and error.__cause__ else error
    own, place = _is_own(cause)
    if not own:
        return "from within", f"{message} [{type(cause).__name__} at {place}]", 0
    if file and not re.match(re.escape(file) + r"(:\d+)?: ", str(error)):
        return "unnamed", _with_place(error, message), 0
    return "refused", message, 0


def _is_own(error):
    """Whether the last line that ran is a ``raise`` of the package, and where it is."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return True, "?"
    name, line = trace.tb_frame.f_code.co_filename, trace.tb_lineno
    if any(reader in name for reader in _READERS) or isinstance(error, OSError | UnicodeError):
        return True, name
    written = linecache.getline(name, line).strip()
    ours = str(PROJECT / "tenscontrol") in name and written.startswith("raise ")
    return ours, f"{Path(name).name}:{line} {written}"


def _with_place(error, message):
    return f"{message} [{_is_own(error)[1]}]"


def _worker(arguments):
    """Read numbers, write outcomes as JSON, one a line."""
    import resource  # POSIX

    limit = int(arguments.memory * 1e9)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    import tenscontrol as tc

    # As Ctrl-C would, not by an exception, which CasADi keeps to itself.
    signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    loading = importlib.import_module("tenscontrol.scene.load_scene")
    built = loading.build_structure

    def announced(document):  # that a scene is large must be known if it is never loaded
        print(LARGE, flush=True)
        structure = built(document)
        print(structure.nodes.shape[1], flush=True)
        return structure

    loading.build_structure = announced
    tc.load_scene(SHIPPED[0])  # what takes time and memory once
    print("ready", flush=True)
    with suppress(BrokenPipeError), tempfile.TemporaryDirectory() as folder:  # it ends early
        file = Path(folder, "scene.toml")
        for line in sys.stdin:
            number = int(line)
            file.write_bytes(spoilt(number, arguments.seed))
            _reset_peak()
            print(0, flush=True)
            began = time.process_time()  # that of others on the machine does not count
            kind, message, size = outcome(file, run=number % 10 == 0)
            seconds = time.process_time() - began
            found = number, kind, message[:300], size, seconds, _peak(), file.stat().st_size
            print(json.dumps(found), flush=True)


def _reset_peak():
    """Forget the largest memory of before, where the system can."""
    if Path("/proc/self/clear_refs").exists():
        Path("/proc/self/clear_refs").write_text("5")


def _peak():
    """The largest memory of this process, MB."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(re.search(r"VmHWM:\s*(\d+)", status.read_text()).group(1)) / 1e3
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def campaign(numbers, arguments):
    """Outcomes of these numbers, from children that are started anew where one ends."""
    todo, done = queue.Queue(), queue.Queue()
    for number in numbers:
        todo.put(number)
    threads = [
        threading.Thread(target=_feed, args=(todo, done, arguments), daemon=True)
        for _ in range(arguments.processes)
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) or not done.empty():
        with suppress(queue.Empty):
            yield done.get(timeout=0.2)


def _feed(todo, done, arguments):
    """Give numbers to one child at a time until there are none."""
    call = [sys.executable, "-m", "tests.fuzz.scenes", "--worker", "--seed", str(arguments.seed)]
    call += ["--memory", str(arguments.memory)]
    child = None
    while True:
        try:
            number = todo.get_nowait()
        except queue.Empty:
            break
        if child is None:
            child = subprocess.Popen(
                call, cwd=PROJECT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            while child.stdout.readline().strip() not in ("ready", ""):
                pass
        timer = threading.Timer(arguments.seconds, child.kill)
        timer.start()
        child.stdin.write(f"{number}\n")
        child.stdin.flush()
        size, answer = 0, child.stdout.readline()
        while answer.strip().isdigit():
            size, answer = int(answer), child.stdout.readline()
        late = not timer.is_alive()
        timer.cancel()
        if answer:
            found = json.loads(answer)
            done.put([*found[:3], max(size, found[3]), *found[4:]])
            if found[5] > HELD:  # it may hold on to it, and the next would seem to need it
                child.stdin.close()
                child.wait()
                child = None
            continue
        child.wait()
        kind = "hang" if late else f"crash with status {child.returncode}"
        done.put([number, kind, "", size, arguments.seconds if late else 0.0, 0.0, 0])
        child = None
    if child is not None:
        child.stdin.close()
        child.wait()


def is_bad(found, seconds=10.0, megabytes=500.0):
    """Whether an outcome is not as it should be; a scene of many nodes may take its time."""
    _, kind, _, size, taken, peak, _ = found
    if kind == "hang" or "MemoryError" in found[2]:
        return size < LARGE
    if kind not in ("refused", "ran", "ran away", "loaded"):
        return True
    return (taken > seconds or peak > megabytes) and size < LARGE


def _parser():
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.scenes")
    parser.add_argument("--count", type=int, default=1000, help="how many files")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--memory", type=float, default=4.0, help="limit of a child, GB")
    parser.add_argument("--seconds", type=float, default=60.0, help="after which a child is ended")
    parser.add_argument("--minutes", type=float, default=1e6, help="after which it ends early")
    parser.add_argument("--only", type=int, help="write this file, and say what becomes of it")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    return parser


def main():
    arguments = _parser().parse_args()
    if arguments.worker:
        _worker(arguments)
        return 0
    numbers = range(arguments.first, arguments.first + arguments.count)
    if arguments.only is not None:
        sys.stdout.buffer.write(spoilt(arguments.only, arguments.seed)[:3000] + b"\n")
        numbers = [arguments.only]
    kinds, bad, slowest, largest, lined = Counter(), Counter(), (0.0, 0), (0.0, 0), 0
    end = time.monotonic() + 60 * arguments.minutes
    for found in campaign(numbers, arguments):
        if time.monotonic() > end:
            break
        number, kind, message, size, taken, peak, length = found
        kinds[kind] += 1
        lined += kind == "refused" and bool(re.search(r"scene\.toml:\d+: ", message))
        if size < LARGE:
            slowest, largest = max(slowest, (taken, number)), max(largest, (peak, number))
        if is_bad(found) or arguments.only is not None:
            bad[kind] += 1
            print(
                f"{number}: {kind}: {message} ({size} nodes, {length} bytes, {taken:.1f} s, "
                f"{peak:.0f} MB)",
                flush=True,
            )
    print(f"{sum(kinds.values())} files: {dict(kinds)}; {lined} refusals name the line")
    print(
        f"slowest {slowest[0]:.1f} s (number {slowest[1]}), largest {largest[0]:.0f} MB "
        f"(number {largest[1]}); not as they should be: {sum(bad.values())}"
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
