"""The suite of extreme cases: what it finds, and that it would find what is wrong."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.methods import METHODS
from tests.benchmarks import extreme_cases, suite
from tests.benchmarks.extreme_cases import ASKED, Extreme, methods
from tests.benchmarks.suite import Truth, cells, judge, judged, main, summary, truth

extremes = cache(extreme_cases.extremes)

GAMMA = np.repeat([10.0, 10.0, 0.9 * np.sqrt(3) * 10.0], 3)


@pytest.fixture(scope="module")
def quick():
    return judged(quick=True)


@pytest.fixture(scope="module")
def prism_case():
    return Extreme("prism", "let go", tc.Scene(tc.Model(tc.prism()), 1.0, force_density=GAMMA))


# ---- what it finds ----


def test_no_run_is_silently_wrong(quick):
    assert not any(row.verdict == "SILENT" for row in quick)


def test_every_case_runs_with_every_method(quick):
    assert (set(METHODS) | {"auto"}) - {"rk4_plain"} < set(methods())
    cases = {case.name for case in extremes(quick=True)}
    assert {(row.case, row.method) for row in quick} == {(c, m) for c in cases for m in methods()}


def test_most_runs_are_accurate_and_long_steps_warn(quick):
    assert sum(row.verdict == "accurate" for row in quick) > 0.7 * len(quick)
    warned = {row.method for row in quick if "too long" in row.case and row.verdict == "warned"}
    assert {"rk4", "energy_momentum, step"} <= warned


def test_an_accurate_run_is_as_accurate_as_asked(quick):
    for row in quick:
        if row.verdict == "accurate":
            assert row.error <= ASKED
            assert row.reference_error <= 0.1 * ASKED


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


def test_a_method_that_refuses_gives_its_reason(prism_case, monkeypatch):
    known = truth(prism_case)

    def refuse(*_, **__):
        raise ValueError("method takes no damping")

    monkeypatch.setattr(suite, "simulate", refuse)
    row = judge(prism_case, known, "rk4")
    assert row.verdict == "refused"
    assert row.reason == "method takes no damping"


def test_a_run_that_blows_up_is_stopped(prism_case):
    case = replace(prism_case, longer=1e3, outputs=1)
    row = judge(case, truth(case), "rk4")
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


# ---- the table ----


def test_the_table_names_every_case_and_method(quick):
    head, lines = cells(quick)
    assert head == ["case", "truth", "growth", *methods()]
    assert [line[0] for line in lines] == [case.name for case in extremes(quick=True)]
    assert {len(line) for line in lines} == {len(head)}
    assert f"{len(quick)} runs" in summary(quick)


def test_the_command_prints_the_table_and_saves_it(capsys, tmp_path):
    file = tmp_path / "suite.csv"
    assert main(["--quick", "--only", "free bar", "--csv", str(file)]) == 0
    assert "free bar turning" in capsys.readouterr().out
    assert file.read_text(encoding="utf-8").count("free bar turning") == 1


def test_the_command_fails_where_a_run_is_silent(monkeypatch, capsys):
    monkeypatch.setattr(suite, "ASKED", 1e-30)
    assert main(["--quick", "--only", "free bar"]) == 1
    assert "SILENT: free bar" in capsys.readouterr().out


def test_an_unknown_case_is_refused():
    with pytest.raises(SystemExit, match="--only is 'teapot', found in none of the cases"):
        main(["--only", "teapot"])
