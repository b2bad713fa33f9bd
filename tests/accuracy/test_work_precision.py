"""Error against run time: what is measured, kept, refused, and made of it."""

import csv
from dataclasses import fields, replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy import Peer, Solution
from tests.accuracy.scenes import paper_case


class Exact(Peer):
    """Returns the reference with node 2 moved by the setting along x, from the third time on."""

    name = "exact"
    settings = (1e-3, 1e-5)

    def __init__(self, reference):
        self.reference = reference
        self.calls = 0

    def refuse(self, case):
        return None

    def prepare(self, case, setting, times):
        np.testing.assert_array_equal(times, self.reference.time)
        nodes = self.reference.nodes.copy()
        nodes[0, 2, 2:-1] += setting

        def run():
            self.calls += 1
            return Solution(nodes, None, 7)

        return run


class Broken(Exact):
    name = "broken"
    settings = (1.0,)

    def prepare(self, case, setting, times):
        def run():
            raise RuntimeError("step size vanished")

        return run


class Absent(Exact):
    name = "absent"

    def refuse(self, case):
        return "it is not installed"


@pytest.fixture(scope="module")
def case():
    return paper_case(0.4)


@pytest.fixture(scope="module")
def reference(case):
    return tc.accuracy.converged_motion(case, outputs=10)


@pytest.fixture(scope="module")
def found(case, reference):
    peers = [Exact(reference), Broken(reference), Absent(reference)]
    settings = {"rk4": [0.02, 0.01, 0.005], "dop853": [1e-6, 1e-15]}
    return tc.work_precision(case, ["rk4", "dop853"], settings, peers, reference, repeats=2)


def test_errors_are_those_of_a_simulation(case, reference, found):
    for row in found.of("rk4"):
        run = tc.simulate(
            case.model,
            0.4,
            rest_length=case.input_value,
            step=row.setting,
            method="rk4",
            error="none",
        )
        every = round(0.04 / row.setting)
        distance = np.linalg.norm(run.nodes[:, :, every::every] - reference.nodes, axis=0)
        assert row.error == pytest.approx(distance.max(), rel=1e-6)
        assert row.end_error == pytest.approx(distance[:, -1].max(), rel=1e-6)
        assert row.relative_error == row.error / case.size
        stretch = np.abs(run.bar_length_error[:, every::every]).max()
        assert row.bar_length_drift == pytest.approx(stretch, rel=1e-6)
        energy = np.abs(run.energy[::every] - run.energy[0]).max()
        exchanged = max(run.kinetic_energy.max(), np.ptp(run.potential_energy))
        assert row.energy_error == pytest.approx(energy / exchanged, rel=0.1)
        assert row.evaluations == run.evaluations
        assert row.steps == run.steps
        assert row.switches > 0


def test_momentum_of_a_free_prism_stays(found):
    for row in found.of("rk4"):
        assert row.momentum_drift < 1e-13
        assert row.angular_momentum_drift < 1e-13


def test_a_failed_run_is_kept_with_its_reason(found):
    bad = found.of("dop853")[-1]
    assert "tolerance is 1e-15, expected at least" in bad.failure
    assert np.isnan(bad.error)
    (broken,) = found.of("broken")
    assert broken.failure == "step size vanished"
    assert found.failures == (bad, broken)
    for text in (found.table(), found.to_markdown()):
        assert "step size vanished" in text
        assert "tolerance is 1e-15" in text


def test_a_run_that_blows_up_is_kept():
    case = paper_case(20.0, vertical=45.0)
    reference = tc.accuracy.converged_motion(paper_case(0.4), outputs=4)
    stretched = replace(reference, time=np.arange(1.0, 5.0) * 5.0)
    (row,) = tc.work_precision(case, ["rk4"], {"rk4": [5.0]}, (), stretched, repeats=1).rows
    assert "no longer finite" in row.failure or row.error > 1.0


def test_peers_are_measured_like_our_own(found):
    coarse, fine = found.of("exact")
    assert coarse.error == pytest.approx(1e-3, rel=1e-9)
    assert fine.error == pytest.approx(1e-5, rel=1e-7)
    assert coarse.end_error == 0.0
    assert (coarse.evaluations, coarse.steps, coarse.is_peer) == (7, None, True)
    assert np.isnan(coarse.energy_error)


def test_who_does_not_take_part_is_named(found):
    assert found.refused == (("absent", "it is not installed"),)
    assert found.peers == ("exact", "broken")
    assert "absent does not take part: it is not installed" in found.table()


def test_runs_are_repeated_as_asked(case, reference):
    peer = Exact(reference)
    rows = tc.work_precision(case, [], {"exact": [1e-3]}, [peer], reference, repeats=4).rows
    assert peer.calls == 1 + 4  # the first fills what is filled once
    assert [row.repeats for row in rows] == [4]


def test_csv_holds_everything(found, tmp_path):
    path = found.to_csv(tmp_path / "a.csv")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.rows)
    for text, row in zip(rows, found.rows, strict=True):
        for field in fields(row):
            value = getattr(row, field.name)
            unknown = value is None or (isinstance(value, float) and np.isnan(value))
            assert text[field.name] == ("" if unknown else str(value))


def test_markdown_is_one_table(found):
    lines = [line for line in found.to_markdown().splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(found.rows)
    assert len({line.count("|") for line in lines}) == 1


def test_errors_near_that_of_the_reference_are_marked(found):
    fine = replace(found.rows[0], error=2 * found.reference.error)
    assert not found.is_resolved(fine)
    assert found.is_resolved(found.rows[0])
    assert "<~" in replace(found, rows=(fine,)).table()
    assert "<~" not in found.table()


def made(found, method, is_peer, points):
    """Rows of a method with these errors and times."""
    row = replace(found.rows[0], method=method, is_peer=is_peer)
    return tuple(replace(row, error=error, time=time) for error, time in points)


@pytest.fixture
def power_laws(found):
    """Ours takes 1e-3 s at 1e-2 m and ten times as long for a hundredth; the peer twice that."""
    ours = [(10.0 ** -(2 + 2 * k), 10.0 ** (k - 3)) for k in range(4)]
    theirs = [(error, 2 * time) for error, time in ours[:3]]
    rows = made(found, "rk4", False, ours) + made(found, "peer", True, theirs)
    return replace(found, rows=rows)


def test_run_time_at_an_error_is_interpolated_between_logarithms(power_laws):
    assert power_laws.time_at("rk4", 1e-5) == pytest.approx(10**-1.5, rel=1e-12)
    assert power_laws.time_at("rk4", 1e-2) == 1e-3
    assert power_laws.time_at("rk4", 0.5) == 1e-3  # never carried on
    assert np.isnan(power_laws.time_at("rk4", 1e-9))
    assert power_laws.fastest(1e-5) == ("rk4", pytest.approx(10**-1.5))
    assert power_laws.fastest(1e-9)[0] == ""


def test_a_slow_run_with_a_larger_error_does_not_count(found):
    rows = made(found, "rk4", False, [(1e-2, 1.0), (1e-3, 5.0), (1e-4, 2.0), (1e-5, 4.0)])
    result = replace(found, rows=rows)
    assert result.time_at("rk4", 1e-3) == pytest.approx(np.sqrt(2.0))


def test_no_error_below_that_of_the_reference_is_reached(found):
    result = replace(found, rows=made(found, "rk4", False, [(1e-3, 1.0), (0.0, 2.0)]))
    assert np.isnan(result.time_at("rk4", 0.5 * found.reference.error))
    assert result.time_at("rk4", found.reference.error) == pytest.approx(2.0)


def test_ratios(power_laws):
    ratios = power_laws.ratios((1e-3, 1e-5, 1e-7, 1e-9))
    np.testing.assert_allclose(ratios.ratio[:2, 0], 2.0)
    assert np.isnan(ratios.ratio[2:, 0]).all()
    assert ratios.reached[:, 0].tolist() == [True, True, False, False]
    assert ratios.best == ("rk4", "rk4", "rk4", "")
    assert ratios.least == pytest.approx(2.0)
    assert ratios.table().count("not reached") == 2
    np.testing.assert_allclose(power_laws.ratios((1e-3,), ["rk4"]).ratio, 1.0)


def test_ratios_without_peers(case, reference):
    found = tc.work_precision(case, ["rk4"], {"rk4": [0.02]}, (), reference, repeats=1)
    assert found.ratios().ratio.shape == (7, 0)
    assert np.isnan(found.ratios().least)


def test_default_settings_span_many_errors():
    case = paper_case(0.4, vertical=45.0)
    found = tc.work_precision(case, ["rk4", "dop853"], repeats=1, outputs=5)
    for method in ("rk4", "dop853"):
        errors = [row.error for row in found.of(method) if not row.failure]
        assert len(errors) >= 5
        assert max(errors) / min(errors) > 1e4


def test_steps_that_shorten_to_the_same_are_run_once(case, reference):
    rows = tc.work_precision(case, ["rk4"], {"rk4": [1.0, 0.1, 0.03]}, (), reference, 1).rows
    assert [row.setting for row in rows] == pytest.approx([0.04, 0.02])


def test_damped_motion_is_compared_with_the_energy_of_the_reference():
    case = paper_case(0.4, vertical=45.0, damping=1.0)
    found = tc.work_precision(case, ["rk4"], {"rk4": [2e-3, 1e-3]}, repeats=1, outputs=10)
    coarse, fine = (row.energy_error for row in found.rows)
    assert 8 < coarse / fine < 32


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"methods": ["euler"]}, ValueError, "methods\\[0\\] is 'euler', expected one of"),
        ({"methods": "rk4"}, TypeError, r"methods is 'rk4', expected a sequence of names"),
        ({"settings": {"rk5": [1.0]}}, ValueError, "a key of settings is 'rk5'"),
        ({"settings": {"rk4": []}}, ValueError, r"settings\['rk4'\] is empty"),
        ({"settings": {"rk4": [0.0]}}, ValueError, r"settings\['rk4'\]\[0\] is 0.0"),
        ({"settings": {"rk4": 0.1}}, TypeError, "is 0.1, expected a sequence of numbers in s"),
        ({"peers": ["mujoco"]}, TypeError, r"peers\[0\] is a str, expected Peer"),
        ({"reference": 3}, TypeError, "reference is a int, expected ConvergedMotion"),
        ({"repeats": 0}, ValueError, "repeats is 0"),
        ({"outputs": 0}, ValueError, "outputs is 0"),
        ({"finest": 0.0}, ValueError, "finest is 0.0"),
        ({"progress": "yes"}, TypeError, "progress is 'yes'"),
    ],
)
def test_bad_input_is_named(case, options, error, message):
    with pytest.raises(error, match=message):
        tc.work_precision(case, **{"methods": ["rk4"]} | options)


def test_a_reference_of_another_motion_is_refused(reference):
    with pytest.raises(ValueError, match=r"reference ends at 0\.4 s, expected .* 0\.5 s"):
        tc.work_precision(paper_case(0.5), ["rk4"], reference=reference)


def test_a_peer_that_returns_too_little_is_told(case, reference):
    class Short(Exact):
        def prepare(self, case, setting, times):
            return lambda: Solution(self.reference.nodes[:, :2], None, 0)

    with pytest.raises(ValueError, match=r"nodes of shape \(3, 2, 10\), expected \(3, 6, 10\)"):
        tc.work_precision(case, [], {"exact": [1.0]}, [Short(reference)], reference)
