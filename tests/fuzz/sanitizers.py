"""Generated C under the sanitizers of the compiler and under valgrind, on absurd samples.

``python -m tests.fuzz.sanitizers`` compiles the C code of every controller in
``tests/deploy/scenes.py``, and the loops over the members of a large structure, with the
address and the undefined-behaviour sanitizer, and runs them on samples among which are NaN,
infinities, the largest and the smallest numbers; then without them under valgrind, which finds
memory that is read before it is written. ``--count`` sets the number of samples, ``--only`` the
names, ``--jobs`` how many are done at once. A law runs twice: as it is, and with a measurement
check that lets everything pass.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics import machine_code
from tenscontrol.dynamics.forms.loops import loops_source
from tests.deploy import scenes

# Casts of what does not fit are not in "undefined".
CHECKED = (
    "-g1",  # lines alone
    "-O0",  # long straight code takes a tenth of the time of -O1
    "-fsanitize=address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
)
PLAIN = ("-g1", "-O0")
WATCHED = {"sanitizers": CHECKED, "valgrind": PLAIN}

# Loops that run long are better compiled where there are many samples.
LOOPS_OF_SOLVERS, MANY = ("active_set.c", "stages.c"), 100
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")

# Nothing is left allocated on purpose, and finding leaks is not possible everywhere.
ENVIRONMENT = os.environ | {"ASAN_OPTIONS": "detect_leaks=0", "LC_ALL": "C"}

ABSURD = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e-300, 0.0, -0.0, 1e19, -1e19)


def run(command, folder, text=None):
    """Run a program; its output, or an AssertionError with what it says."""
    done = subprocess.run(
        command, cwd=folder, input=text, capture_output=True, text=True, env=ENVIRONMENT
    )
    assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stderr[:4000]}"
    return done.stdout


@cache
def can_sanitize():
    """Whether the compiler has the sanitizers: a program of one line is built and run."""
    if machine_code.compiler() is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "one.c").write_text("int main(void) { return 0; }\n")
        try:
            build(["one.c"], Path(folder), CHECKED)
            run(["./program"], folder)
        except AssertionError:
            return False
    return True


_OBJECTS = {}


def compile_each(sources, folder, flags, count):
    """Compile files of controllers to objects, each text once, for a number of samples."""
    cc = [*machine_code.compiler(), "-std=c99", *flags]
    for source in sources:
        better = ["-O1"] if source in LOOPS_OF_SOLVERS and count >= MANY else []
        key = flags, *better, run([*cc, "-E", source], folder)
        made = folder / f"{source[:-2]}.o"
        if key not in _OBJECTS:
            run([*cc, *better, "-c", source], folder)
            _OBJECTS[key] = made.read_bytes()
        made.write_bytes(_OBJECTS[key])


def build(sources, folder, flags):
    """Build a program of files in a folder."""
    cc = machine_code.compiler()
    run([*cc, "-std=c99", *flags, *sources, "-lm", "-o", "program"], folder)


def play(folder, flags, text=None):
    """Run a program that is built, under valgrind where no sanitizer watches it."""
    watched = flags is CHECKED or shutil.which("valgrind") is None
    command = [] if watched else ["valgrind", "-q", "--error-exitcode=9"]
    return run([*command, "./program"], folder, text)


# ---- controllers ----

# Arrays have their size and no more, so that a step beyond it is seen.
_PLAY = """
#include <stdio.h>
#include <stdlib.h>
#include "controller.h"

static double *numbers(int count)
{
    double *values = malloc((size_t)count * sizeof *values);
    int i;
    for (i = 0; i < count; i++)
        if (scanf("%lf", &values[i]) != 1)
            exit(2);
    return values;
}

int main(void)
{
    char what;
    while (scanf(" %c", &what) == 1) {
        double *time, *nodes, *velocities, *command;
        int i, status;
        if (what == 'r') {
            controller_reset();
            continue;
        }
        command = numbers(CONTROLLER_COMMANDS);
        if (what == 'a') {
            printf("applied %d\\n", controller_applied(command));
            free(command);
            continue;
        }
        time = numbers(1);
        nodes = numbers(CONTROLLER_COORDINATES);
        velocities = numbers(CONTROLLER_COORDINATES);
        status = controller_command(*time, nodes, velocities, command);
        printf("%d %d", status, controller_iterations());
        for (i = 0; i < CONTROLLER_COMMANDS; i++)
            printf(" %.17g", command[i]);
        printf("\\n");
        free(time); free(nodes); free(velocities); free(command);
    }
    return 0;
}
"""


def regulator():
    """An LQR that limits changes."""
    plant = scenes.plant("rest_length")
    return tc.LQR(
        plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE, winches=scenes.WINDING
    )


def gait():
    """A ball of six bars that rolls by plans from a table."""
    return scenes.rolling_gait()


CONTROLLERS = {
    each.__name__: each
    for each in (
        regulator,
        scenes.of_force_density,
        scenes.of_rest_length,
        scenes.of_few_modes,
        scenes.winding,
        scenes.with_load,
        scenes.crossed,
        scenes.nonlinear,
        scenes.nonlinear_of_rest_length,
        scenes.nonlinear_with_load,
        scenes.rolling,
        scenes.sliding,
        gait,
    )
}


def bounds_of(controller):
    """Least and largest commands."""
    if isinstance(controller, tc.shape.RollingGait):
        return controller.settings.plans.bounds
    return controller.bounds


def motion(controller, size, rng):
    """A shape near the usual one, and velocities at random; a gait stands still at times."""
    if isinstance(controller, tc.shape.RollingGait):
        nodes = controller.settings.structure.nodes
        nodes = nodes + 0.01 * min(size, 1.0) * rng.normal(size=nodes.shape)
        return nodes, rng.choice([0.0, 0.0, 0.0, size]) * rng.normal(size=nodes.shape)
    plant = controller.plant
    nodes = plant.to_nodes(0.02 * min(size, 1.0) * rng.normal(size=plant.degrees_of_freedom))
    return nodes, size * rng.normal(size=nodes.shape)


def samples(controller, count, seed=0):
    """A line for each sample: motions that may be, all that may not, and actuators that stick."""
    rng = np.random.default_rng(seed)
    commands = len(bounds_of(controller)[0])
    lines = ["r"]

    def line(what, *parts):
        numbers = np.concatenate([np.ravel(part, order="F") for part in parts])
        lines.append(what + " " + " ".join(repr(float(x)) for x in numbers))

    nothing = np.zeros(commands)
    for k in range(count):
        size = 10.0 ** rng.uniform(-4, 0.5)
        nodes, velocities = motion(controller, size, rng)
        time = k * scenes.SAMPLE
        kind = k % 11
        if kind == 3:
            time = rng.choice([1e300, -1e300, 1e19, 2.0**31, 5e-324, *ABSURD])
        elif kind == 5:
            nodes.flat[rng.integers(nodes.size)] = rng.choice(ABSURD)
        elif kind == 6:
            velocities.flat[rng.integers(nodes.size)] = rng.choice(ABSURD)
        elif kind == 7:
            nodes, velocities = rng.choice(ABSURD, nodes.shape), rng.choice(ABSURD, nodes.shape)
        elif kind == 8:
            nodes = rng.choice([0.0, -1.0, 1e150, 1e-160, 1e300]) * nodes
            velocities = rng.choice([0.0, -1.0, 1e150, 1e-160, 1e300]) * velocities
        elif kind == 9:
            applied = nothing + rng.choice([*ABSURD, 20.0])
            applied[rng.integers(commands)] = rng.choice(ABSURD)
            line("a", applied)
        elif kind == 10 and rng.random() < 0.2:
            lines.append("r")
        line("s", nothing, [time], nodes, velocities)
    return "\n".join(lines) + "\n"


def check_controller(name, count, flags=CHECKED):
    """Generate, build and run a controller; return how many samples were answered."""
    controller, answered = CONTROLLERS[name](), 0
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work) / "code"
        made = tc.generate_c(controller, folder)
        (folder / "main.c").write_text(_PLAY)
        sources = [file for file in made.files if file.endswith(".c")]
        compile_each(sources, folder, flags, count)
        cc = [*machine_code.compiler(), "-std=c99", *flags]
        for prepare in (None, without_check):
            if prepare is not None:
                prepare(folder)
            run([*cc, *WARNINGS, "-c", "controller.c"], folder)
            build([file[:-2] + ".o" for file in sources], folder, flags)
            lines = play(folder, flags, samples(controller, count)).splitlines()
            rows = [line.split()[2:] for line in lines if not line.startswith("applied")]
            commands = np.array(rows, dtype=float)
            low, high = bounds_of(controller)
            assert ((low <= commands) & (commands <= high)).all(), "a command beyond its bounds"
            answered += len(rows)
    return answered


def without_check(folder):
    """Let the measurement check refuse only what is not finite."""
    data = folder / "controller_data.h"
    text = re.sub(r"(#define (?:BARS|FIXED|ROLLERS)) .*", r"\1 0", data.read_text())
    limits = "FARTHEST|SPREAD|FASTEST|LARGEST_VELOCITY"
    data.write_text(re.sub(rf"(#define (?:{limits})) .*", r"\1 INFINITY", text))


# ---- loops over the members ----

_CALL = """
#include <stdio.h>
#include <stdlib.h>

static unsigned long seed = 1;
static double absurd[] = {%(absurd)s};

static double any(int mode)
{
    seed = (seed * 1103515245ul + 12345ul) & 0x7ffffffful;
    if (mode < %(count)d)
        return absurd[mode];
    if (mode %% 2 == 0 && seed / 65536 %% 8 == 0)
        return absurd[seed / 65536 / 8 %% %(count)d];
    return (double)seed / 1073741824.0 - 1.0;
}

static long size(const casadi_int *of)
{
    return (long)(of[2] == 1 ? of[0] * of[1] : of[2 + of[1]]);
}

static void *room(long count, size_t each)
{
    return malloc(count > 0 ? (size_t)count * each : 1);
}
"""

_CALL_ONE = """
static void call_%(name)s(int mode)
{
    casadi_int n_in = %(name)s_n_in(), n_out = %(name)s_n_out(), i;
    casadi_int sz_arg, sz_res, sz_iw, sz_w;
    const double **arg;
    double **res, *w;
    casadi_int *iw;
    %(name)s_work(&sz_arg, &sz_res, &sz_iw, &sz_w);
    arg = room((long)sz_arg, sizeof *arg);
    res = room((long)sz_res, sizeof *res);
    iw = room((long)sz_iw, sizeof *iw);
    w = room((long)sz_w, sizeof *w);
    for (i = 0; i < n_in; i++) {
        long k, count = size(%(name)s_sparsity_in(i));
        double *values = room(count, sizeof *values);
        for (k = 0; k < count; k++)
            values[k] = any(mode);
        arg[i] = values;
    }
    for (i = 0; i < n_out; i++)
        res[i] = room(size(%(name)s_sparsity_out(i)), sizeof **res);
    if (%(name)s(arg, res, iw, w, 0) != 0)
        printf("refused ");
    for (i = 0; i < n_out; i++) {
        long k, count = size(%(name)s_sparsity_out(i));
        for (k = 0; k < count; k++)
            printf(" %%g", res[i][k]);
        free(res[i]);
    }
    printf("\\n");
    for (i = 0; i < n_in; i++)
        free((void *)arg[i]);
    free(arg); free(res); free(iw); free(w);
}
"""


@cache
def model(damping=0.0, supported=False):
    """A prism, free or on supports."""
    given = tc.prism()
    fixed = [3, 4, 5] if supported else []
    structure = tc.Structure(given.nodes, given.bars, given.strings, bar_mass=1.0, fixed=fixed)
    return tc.Model(structure, strings=tc.LinearStrings(stiffness=100.0, damping=damping))


def loops(damping, supported):
    """The C text of the loops over the members, with its functions."""
    shown = model(damping, supported)
    load = np.ones_like(shown.structure.nodes)
    source = loops_source(shown.forces("rest_length"), load)
    return [(name, source) for name in ("slope", "gap", "force")]


LOOPS = {
    "loops": partial(loops, 0.5, False),
    "loops on supports": partial(loops, 0.5, True),
}


def check_loops(name, count, flags=CHECKED):
    """Build the loops of a scene and call them; return how often."""
    by_text = {}
    for function, source in LOOPS[name]():
        by_text.setdefault(source, []).append(function)
    words = {
        "absurd": ", ".join(_c(x) for x in ABSURD),
        "count": len(ABSURD),
    }
    called = 0
    with tempfile.TemporaryDirectory() as work:
        for source, functions in by_text.items():
            calls = "".join(f"        call_{each}(mode);\n" for each in functions)
            parts = [_CALL % words, *(_CALL_ONE % {"name": each} for each in functions)]
            loop = f"    int mode;\n    for (mode = 0; mode < {count}; mode++) {{\n{calls}    }}\n"
            main = f"int main(void)\n{{\n{loop}    return 0;\n}}\n"
            text = "\n".join([source, *parts, main])
            (Path(work) / "function.c").write_text(text)
            build(["function.c"], work, flags)
            called += len(play(work, flags).splitlines())
    assert called > 0
    return called


def _c(value):
    return "NAN" if np.isnan(value) else str(value).replace("inf", "INFINITY")


def checked(name, watched, count):
    """Return what a check of one name found, and whether it is clean."""
    check = check_controller if name in CONTROLLERS else check_loops
    try:
        return f"{check(name, count, WATCHED[watched]):6d} calls, clean", True
    except AssertionError as error:
        return f"NOT CLEAN: {error}", False


def main(arguments=None):
    names = [*CONTROLLERS, *LOOPS]
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.sanitizers", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="samples (default: 1000)")
    parser.add_argument("--only", nargs="*", default=names, choices=names, metavar="NAME")
    parser.add_argument("--jobs", type=int, default=2, help="checks at once (default: 2)")
    options = parser.parse_args(arguments)
    if not can_sanitize():
        print("this compiler has no sanitizers")
        return 2
    counts = {"sanitizers": options.count}
    if shutil.which("valgrind") is not None:
        counts["valgrind"] = max(1, options.count // 10)
    tasks = [(name, watched, counts[watched]) for name in options.only for watched in counts]
    wrong = 0
    with ProcessPoolExecutor(options.jobs) as pool:
        every = zip(tasks, pool.map(checked, *zip(*tasks, strict=True)), strict=True)
        for (name, watched, _), (said, is_clean) in every:
            wrong += not is_clean
            print(f"{name:28s} {watched:12s} {said}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
