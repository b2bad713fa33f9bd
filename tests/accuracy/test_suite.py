"""The suite of extreme cases: what it finds, and that it would find what is wrong."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.extreme_cases import ASKED, Extreme, extremes, methods
from tenscontrol.accuracy.suite import VERDICTS, Truth, extreme_suite, judge, main, truth
from tenscontrol.integrate import METHODS

GAMMA = np.repeat([10.0, 10.0, 0.9 * np.sqrt(3) * 10.0], 3)


@pytest.fixture(scope="module")
def quick():
    return extreme_suite(quick=True)


@pytest.fixture(scope="module")
def prism_case():
    return Extreme("prism", "let go", tc.Scene(tc.Model(tc.prism()), 1.0, force_density=GAMMA))


# ---- what it finds ----


def test_no_run_is_silently_wrong(quick):
    assert not quick.silent


def test_every_case_runs_with_every_method(quick):
    assert set(METHODS) | {"auto"} < set(quick.methods)
    assert len(quick.rows) == len(quick.cases) * len(quick.methods)
    assert sum(quick.counts.values()) == len(quick.rows)


def test_most_runs_are_accurate_and_long_steps_are_told(quick):
    assert quick.counts["accurate"] > 0.7 * len(quick.rows)
    told = {row.method for row in quick.rows if "too long" in row.case and row.verdict == "warned"}
    assert {"rk4", "rattle", "energy_momentum, step"} <= told


def test_an_accurate_run_is_as_accurate_as_asked(quick):
    for row in quick.rows:
        if row.verdict == "accurate":
            assert row.error <= row.asked
            assert row.reference_error <= 0.1 * row.asked


def test_the_full_suite_has_a_case_of_each_kind():
    groups = {case.group for case in extremes()}
    assert len(groups) >= 15
    assert len({case.name for case in extremes()}) == len(extremes())


def test_the_full_suite_has_ground_of_every_kind():
    grounded = [case for case in extremes() if case.case.model.contacts is not None]
    assert len({case.group for case in grounded}) >= 10
    laws = [law for case in grounded for law in case.case.model.ground]
    stiffness = [law.stiffness for law in laws if isinstance(law, tc.Ground)]
    assert min(stiffness) <= 1e2
    assert max(stiffness) == 1e9
    assert max(law.friction for law in laws) == 5.0
    assert {type(law).__name__ for law in laws} == {"Ground", "HertzGround", "SmoothGround"}
    assert max(case.case.duration for case in grounded) >= 60.0


def test_a_drop_does_not_change_with_units():
    cases = {case.label: case for case in extremes() if case.group == "drop of another scale"}
    assert len(cases) == 2
    shapes = [truth(case).nodes / case.case.size for case in cases.values()]
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-7)


# ---- that it would find what is wrong ----


def test_a_wrong_truth_makes_every_run_silent(prism_case):
    known = truth(prism_case)
    shifted = replace(known, nodes=known.nodes + 0.01)
    assert judge(prism_case, known, "dop853").verdict == "accurate"
    assert judge(prism_case, shifted, "dop853").verdict == "SILENT"


def test_a_run_that_is_too_long_is_not_started(prism_case):
    row = judge(replace(prism_case, budget=10.0), truth(prism_case), "rk4")
    assert row.verdict == "too long"
    assert "evaluations, 1e+01 are allowed" in row.reason
    assert row.evaluations > 10


def test_a_method_that_refuses_gives_its_reason(prism_case, monkeypatch):
    known = truth(prism_case)

    def refuse(*_, **__):
        raise ValueError("method takes no damping")

    monkeypatch.setattr("tenscontrol.accuracy.suite.simulate", refuse)
    row = judge(prism_case, known, "rattle6")
    assert row.verdict == "refused"
    assert row.reason == "method takes no damping"


def test_a_run_that_blows_up_is_stopped(prism_case):
    case = replace(prism_case, longer=1e3, outputs=1)
    row = judge(case, truth(case), "rattle6")
    assert row.verdict in ("stopped", "warned")
    assert row.reason


def test_growth_limits_what_is_compared():
    known = Truth(np.zeros((3, 2, 4)), 0.0, np.array([1.0, 1e2, 1e4, 1e6]), 4, "made up")
    assert known.comparable(1e-12) == 4
    assert known.comparable(1e-6) == 2
    assert known.comparable(1.0) == 1
    assert replace(known, outputs=0).comparable(1e-12) == 0


def test_a_closed_form_and_a_computed_truth_agree():
    case = next(case for case in extremes() if case.closed_form is not None)
    known, computed = truth(case), truth(replace(case, closed_form=None))
    assert known.how == "closed form"
    np.testing.assert_allclose(computed.nodes, known.nodes, atol=1e-9 * case.case.size)


def test_a_motion_does_not_change_with_units():
    cases = [case for case in extremes() if case.group == "scale"]
    shapes = [truth(case).nodes / case.case.size for case in cases]
    assert len(shapes) == 3
    for shape in shapes[1:]:
        np.testing.assert_allclose(shape, shapes[0], atol=1e-9)


@pytest.mark.parametrize("method", ["rk4", "dop853", "energy_momentum", "auto"])
def test_the_answer_of_a_method_does_not_change_with_units(method):
    found = []
    for length in (1e-6, 1.0, 1e3):
        structure = tc.prism(radius=0.5 * length, height=length, bar_mass=length**3)
        given = {"step": 0.01 * length} if method == "rk4" else {"tolerance": 1e-6}
        run = tc.simulate(
            tc.Model(structure),
            length,
            force_density=GAMMA * length,
            method=method,
            output_step=0.1 * length,
            **given,
        )
        found.append(run.nodes / length)
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    np.testing.assert_allclose(found[2], found[0], atol=1e-9)


# ---- result and command ----


def test_tables_name_every_case_and_method(quick):
    for text in (quick.table(), quick.to_markdown()):
        assert all(name in text for name in (*quick.cases, *quick.methods))
        assert f"{len(quick.rows)} runs" in text


def test_csv_has_a_line_for_each_run(quick, tmp_path):
    with quick.to_csv(tmp_path / "suite.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["verdict"] for row in rows] == [row.verdict for row in quick.rows]
    assert {row["verdict"] for row in rows} <= set(VERDICTS)


def test_command_prints_the_table_and_saves_it(capsys, tmp_path):
    file = tmp_path / "suite.md"
    status = main(["--quick", "--only", "free bar", "--markdown", str(file)])
    assert status == 0
    assert "free bar turning" in capsys.readouterr().out
    assert "| free bar turning" in file.read_text(encoding="utf-8")


def test_command_fails_where_a_run_is_silent(monkeypatch, capsys):
    monkeypatch.setattr("tenscontrol.accuracy.suite.ASKED", 1e-30)
    assert main(["--quick", "--only", "free bar"]) == 1
    assert "SILENT: free bar" in capsys.readouterr().out


def test_an_unknown_case_is_refused(capsys):
    with pytest.raises(ValueError, match="only is 'teapot', found in none of the cases"):
        extreme_suite(only="teapot")
    assert main(["--only", "teapot"]) == 2
    assert "teapot" in capsys.readouterr().err


def test_asked_and_methods_are_sound():
    assert ASKED == 1e-3
    assert len(methods()) == len(METHODS) + 2


# ---- the estimate that keeps runs from being silent ----


@pytest.mark.parametrize(("method", "step"), [("rk4", 0.1), ("rattle", 0.03), ("rattle4", 0.15)])
def test_the_estimate_is_near_the_error(prism_case, method, step):
    case = prism_case.case
    run = tc.simulate(
        case.model, 5.0, force_density=GAMMA, method=method, step=step, limits=tc.HealthLimits(
            energy_error=None, bar_length_error=None, position_error=None)
    )  # fmt: skip
    exact = tc.simulate(
        case.model, 5.0, force_density=GAMMA, method="dop853", tolerance=1e-12,
        output_step=5.0 / (len(run.time) - 1),
    )  # fmt: skip
    error = np.linalg.norm(run.nodes - exact.nodes, axis=0).max() / case.size
    assert error / 2 < run.error.max() < 30 * error


def test_long_steps_that_conserve_energy_are_told():
    """The energy says nothing here: the method conserves it whatever the step."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    start = tc.to_rest_length(model, tc.prism().nodes, GAMMA).rest_length
    with pytest.warns(tc.simulation.AccuracyWarning, match="position error"):
        run = tc.simulate(model, 2.0, rest_length=start, method="energy_momentum", step=0.1)
    assert run.health.energy_error < 1e-9
