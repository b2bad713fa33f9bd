"""Controllers as C code do what they do in Python, in closed loop and on spoilt input."""

import os
import re
import shutil
import subprocess

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.demo import tour as demo
from tenscontrol.dynamics.machine_code import compiler
from tests.deploy import scenes

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")

STILL = np.zeros((3, 6))


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """The demo's motion by γ, commanded by both until the prism stands still again."""
    pair = scenes.pair_of(scenes.of_force_density(), tmp_path_factory.mktemp("moved"))
    return pair, scenes.closed_loop(pair, samples=500)


def test_force_density_along_a_moving_reference(moved):
    pair, run = moved
    scenes.check(pair)
    # Eight samples were spoilt, and the prism arrived all the same.
    height = demo.height_of(run.nodes)[run.time > 9.0]
    assert np.abs(height - demo.TARGET).max() < 2e-3


def test_rest_length_with_winches_and_soft_limits(tmp_path):
    pair = scenes.pair_of(scenes.of_rest_length(), tmp_path)
    start = scenes.plant("rest_length").rest_length
    run = scenes.closed_loop(pair, winches=scenes.WINCHES, rest_length=start, input="rest_length")
    scenes.check(pair)
    assert run.control.command.shape == (9, scenes.SAMPLES)


def test_own_weights(tmp_path):
    """Stages are not alike then: the program is prepared in each sample."""
    limit = tc.OutputLimit(scenes.height_row(), low=0.8, penalty=100.0)
    given = {"max_change": 10.0, "outputs": [limit], "load_gain": 0.1}
    pair = scenes.pair_of(scenes.of_force_density(**given, **scenes.own_weights()), tmp_path)
    scenes.pushed(pair, samples=25)
    assert pair.error < 1e-12
    assert max(pair.iterations) > 3
    text = (tmp_path / "controller_data.h").read_text("utf-8")
    assert "#define ALIKE 0" in text
    assert "#define CROSSED 1" in text


def test_many_inputs_of_few_modes(tmp_path):
    pair = scenes.pair_of(scenes.of_few_modes(), tmp_path)
    scenes.pushed(pair, samples=50)
    assert pair.error < 1e-12
    assert max(pair.iterations) > 3  # changes of the active set
    assert "#define THIN 1" in (tmp_path / "controller_data.h").read_text("utf-8")


def test_ball_with_winches_and_soft_limits(tmp_path):
    one = scenes.tumbling(horizon=4)
    pair = scenes.Pair(one, tc.generate_c(one, tmp_path).compile(), spoilt=(20,), absurd=(25,))
    scenes.shaken(pair, samples=50)
    assert pair.statuses[0] == pair.statuses[1]
    assert pair.error < 1e-12
    assert max(pair.iterations) > 3  # changes of the active set
    # All stages are alike: their motion is in the code once.
    assert "motion_by_state[2304]" in (tmp_path / "controller_data.h").read_text("utf-8")


def test_winches_that_wind_under_an_unknown_load(tmp_path):
    """The state of the program holds the last command too."""
    pair = scenes.pair_of(scenes.winding(), tmp_path)
    start = scenes.plant("rest_length").rest_length
    scenes.closed_loop(
        pair, pull=0.05, winches=scenes.WINDING, rest_length=start, input="rest_length"
    )
    scenes.check(pair)
    assert np.linalg.norm(pair.one.load) > 0.1


def test_regulator_of_winches_that_wind(tmp_path):
    plant = scenes.plant("rest_length")
    law = tc.LQR(
        plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE, winches=scenes.WINDING
    )
    pair = scenes.pair_of(law, tmp_path)
    scenes.closed_loop(
        pair, winches=scenes.WINDING, rest_length=plant.rest_length, input="rest_length"
    )
    scenes.check(pair, solved=False)
    assert law.previous_input_gain is not None


def test_unknown_load_is_estimated_alike(tmp_path):
    pair = scenes.pair_of(scenes.with_load(), tmp_path)
    scenes.closed_loop(pair, pull=2 / 3)
    scenes.check(pair)
    assert np.linalg.norm(pair.one.load) > 0.1


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_lqr(held, tmp_path):
    """Bounds, a largest change and what stands, on motions at random and actuators that stick."""
    plant = scenes.plant(held)
    limits = {"max_force_density": 30.1} if held == "force_density" else {}
    change = 2.0 if held == "force_density" else 0.01
    lqr = tc.LQR(
        plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE, max_change=change, **limits
    )
    pair = scenes.pair_of(lqr, tmp_path)
    rng = np.random.default_rng(2)
    for k in range(scenes.SAMPLES):
        nodes = plant.to_nodes(0.02 * rng.normal(size=9))
        given = pair.command(k * scenes.SAMPLE, nodes, 0.05 * rng.normal(size=(3, 6)))
        pair.applied(given.value + (0.3 * change * rng.normal(size=9) if k % 7 == 0 else 0.0))
    scenes.check(pair, solved=False)
    pair.applied(plant.equilibrium_input + change * rng.normal(size=9))
    pair.command(10.0, plant.to_nodes(np.full(9, 0.03)), STILL)
    holds = "previous input held" if held == "rest_length" else "equilibrium held"
    assert set(pair.statuses[1]) == {
        "ok", "saturated", f"measurement not finite: {holds}", f"measurement not plausible: {holds}"
    }  # fmt: skip


def test_the_code_falls_back_as_asked(tmp_path):
    """Where somebody else has judged the measurement."""
    plant = scenes.plant("rest_length")
    lqr = tc.LQR(plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE)
    pair = lqr, tc.generate_c(lqr, tmp_path / "code").compile()
    found = [each.fall_back(Status.MEASUREMENT_NOT_PLAUSIBLE) for each in pair]
    assert [str(each) for each in found] == ["measurement not plausible: equilibrium held"] * 2
    np.testing.assert_array_equal(*[each.value for each in found])


@pytest.fixture(scope="module")
def short_of_iterations(tmp_path_factory):
    """Code whose program is not solved where the prism is pushed hard."""
    plant = scenes.plant("force_density")
    mpc = tc.MPC(
        plant, horizon=4, sample_time=scenes.SAMPLE, max_force_density=34.0, max_iterations=4
    )
    made = tc.generate_c(mpc, tmp_path_factory.mktemp("short") / "code")
    return mpc, made, made.compile()


def test_out_of_iterations_is_a_fallback(short_of_iterations):
    """Plans are continued until they end, then the equilibrium is held."""
    mpc, _, compiled = short_of_iterations
    rng, answers = np.random.default_rng(1), []
    for k in range(scenes.SAMPLES):
        push = 2.0 if k % 50 < 10 else 0.003
        nodes = mpc.plant.nodes + 0.003 * rng.normal(size=(3, 6))
        answers.append(compiled.command(k * scenes.SAMPLE, nodes, push * rng.normal(size=(3, 6))))
        assert compiled.iterations <= 4
        assert ((answers[-1].value >= 0) & (answers[-1].value <= 34.0)).all()
    held = [each for each in answers if str(each) == "out of iterations: equilibrium held"]
    np.testing.assert_array_equal(held[0].value, mpc.plant.equilibrium_input)
    assert {str(each) for each in answers} == {
        "ok",
        "out of iterations: plan continued",
        "out of iterations: equilibrium held",
    }


def test_reset_is_a_fresh_start(moved):
    """The same commands again, to the last bit, after runs that adapted the solver."""
    pair, _ = moved
    compiled = pair.other
    samples = [np.split(each[1:], 2) for each in pair.asked[:40]]
    runs = []
    for _ in range(2):
        compiled.reset()
        runs.append([
            compiled.command(k * scenes.SAMPLE, *(part.reshape(3, 6, order="F") for part in parts))
            .value
            for k, parts in enumerate(samples)
        ])  # fmt: skip
    np.testing.assert_array_equal(*runs)
    np.testing.assert_array_equal(runs[0], pair.commands[1][:40])


def test_two_of_one_code_have_a_memory_each(short_of_iterations):
    _, made, one = short_of_iterations
    other = made.compile()
    one.reset()
    nodes = scenes.plant("force_density").to_nodes(np.r_[0.02, np.zeros(8)])
    before = one.command(0.0, nodes, STILL).value
    spoilt = np.full((3, 6), np.inf)
    assert str(one.command(0.02, spoilt, STILL)) == "measurement not finite: plan continued"
    assert str(other.command(0.02, spoilt, STILL)) == "measurement not finite: equilibrium held"
    other.reset()
    np.testing.assert_array_equal(other.command(0.0, nodes, STILL).value, before)


def test_files_do_not_say_when_they_were_written(short_of_iterations):
    """A controller becomes the same text every time."""
    _, made, _ = short_of_iterations
    texts = [(made.folder / file).read_text("utf-8") for file in made.files]
    assert len(texts) > 5
    assert not [text for text in texts if re.search(r"\d\d:\d\d:\d\d", text)]


@pytest.mark.parametrize(
    "make",
    [scenes.winding, scenes.nonlinear_of_rest_length, scenes.nonlinear_with_load],
)
def test_code_of_every_law_has_no_warnings(make, tmp_path):
    tc.generate_c(make(), tmp_path)
    strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run([*compiler(), *strict, "-c", "controller.c"], cwd=tmp_path, check=True)


@pytest.fixture(scope="module")
def replay(moved, tmp_path_factory):
    """The program that runs samples from a file, and its lines of 500 samples."""
    folder = tmp_path_factory.mktemp("replay")
    tc.generate_c(moved[0].one, folder, name="height")
    cc = [*compiler(), "-std=c99", "-g"]
    strict = ["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    sources = sorted(path.name for path in folder.glob("*.c"))
    for own in ("height.c", "main.c"):
        subprocess.run([*cc, *strict, "-c", own], cwd=folder, check=True)
        sources.remove(own)
    command = [*cc, *sources, "height.o", "main.o", "-lm", "-o", "replay"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "replay", [" ".join(map(repr, each.tolist())) for each in moved[0].asked]


def test_program_that_replays_prints_the_same(moved, replay):
    pair, (program, lines) = moved[0], replay
    done = subprocess.run(
        [program], input="\n".join(lines), capture_output=True, text=True, check=True
    )
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert len(rows) == len(pair.answers)
    np.testing.assert_array_equal(rows[:, 1], pair.iterations)
    size = np.abs(pair.commands[1]).max()
    np.testing.assert_allclose(rows[:, 2:], pair.commands[1], rtol=0, atol=1e-10 * size)
    assert set(np.flatnonzero(rows[:, 0])) == {*scenes.SPOILT, *scenes.ABSURD}


SAMPLE = " ".join(["0.0"] * 37)


@pytest.mark.parametrize(
    ("given", "answers", "message"),
    [
        ("", 0, None),
        (f"\n{SAMPLE}\r\n \n\t{SAMPLE}  ", 2, None),
        (
            SAMPLE.replace("0.0", "-0x1p-3")
            + "\n"
            + SAMPLE.replace("0.0", "-INF nan 1e-400", 1)[:-8],
            2,
            None,
        ),
        ("0.0 1.0", 0, "line 1 ends after 2 numbers, expected 1 + 36"),
        (
            f"{SAMPLE}\n\n{SAMPLE[:-4]}\n{SAMPLE}",
            1,
            "line 3 ends after 36 numbers, expected 1 + 36",
        ),
        (f"{SAMPLE} 0.0\n", 0, "line 1, word 38: '0.0' is too much, expected 1 + 36 numbers"),
        (f"{SAMPLE} rubbish\n", 0, "line 1, word 38: 'rubbish' is too much"),
        (f"{SAMPLE}\ntime x y z", 1, "line 2, word 1: 'time' is not a number"),
        ("0.0 1,5 2", 0, "line 1, word 2: '1,5' is not a number"),
        ("0.0 0.0 1.0m", 0, "line 1, word 3: '1.0m' is not a number"),
        ("1e999", 0, "line 1, word 1: '1e999' is out of range"),
        ("0 -1e309", 0, "line 1, word 2: '-1e309' is out of range"),
        ("0 1\0 2", 0, "line 1, word 2: '1?' is not a number"),
        ("0 \x1b[31m\xff 2", 0, "line 1, word 2: '?[31m?' is not a number"),
        (9999 * "1", 0, "is not a number"),
        (99 * "\0", 0, "line 1, word 1: '???"),
    ],
)
def test_program_says_which_line_and_word_is_wrong(given, answers, message, replay):
    done = subprocess.run([replay[0]], input=given.encode("latin-1"), capture_output=True)
    said = done.stderr.decode("ascii")
    assert done.returncode == (0 if message is None else 1)
    assert said == "" if message is None else message in said
    assert len(said) < 200
    assert done.stdout.count(b"\n") == answers


@pytest.mark.skipif(os.name != "posix", reason="streams of POSIX")
@pytest.mark.parametrize("count", [1, 10_000])
def test_program_says_that_nobody_takes_its_answers(count, replay, tmp_path):
    (tmp_path / "samples").write_text(f"{SAMPLE}\n" * count)
    for where in (["sh", "-c", '"$0" >&-'], ["sh", "-c", '"$0" >/dev/full']):
        with (tmp_path / "samples").open() as samples:
            done = subprocess.run(
                [*where, replay[0]], stdin=samples, capture_output=True, text=True
            )
        assert done.returncode == 1
        assert "the standard output takes no more" in done.stderr
    done = subprocess.run(
        ["sh", "-c", '"$0" <.', replay[0]], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "the standard input" in done.stderr


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not there")
def test_nothing_is_allocated_and_no_memory_is_misused(replay):
    program, lines = replay
    done = subprocess.run(
        ["valgrind", "--error-exitcode=9", program],
        input="\n".join(lines[50:62]),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 12
    # The buffers of the standard input and output alone.
    assert "total heap usage: 2 allocs" in done.stderr
