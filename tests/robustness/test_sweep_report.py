"""What a report says: rate of success, its interval, ranks, tables."""

import pickle

import numpy as np
import pytest

import tenscontrol as tc
from tests.robustness import cases
from tests.robustness.cases import PARAMETERS, Inline


def of(good, count):
    """A report of so many runs, so many of them a success."""
    records = tuple(
        tc.robustness.store.Record(i, {"x": float(i)}, bool(i < good), {"y": float(i * i)})
        for i in range(count)
    )
    return tc.robustness.SweepReport("case", 0, count, records)


class TestConfidenceInterval:
    @pytest.mark.parametrize(
        ("good", "count"), [(0, 1), (1, 1), (0, 20), (20, 20), (7, 20), (193, 200), (1, 3000)]
    )
    @pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
    def test_it_is_that_of_clopper_and_pearson(self, good, count, level):
        from scipy.stats import binomtest

        oracle = binomtest(good, count).proportion_ci(level, method="exact")
        found = of(good, count).confidence_interval(level)
        assert found == pytest.approx((oracle.low, oracle.high), rel=1e-9, abs=1e-15)

    def test_closed_forms_where_all_or_none_succeed(self):
        assert of(0, 30).confidence_interval(0.9) == pytest.approx((0.0, 1 - 0.05 ** (1 / 30)))
        assert of(30, 30).confidence_interval(0.9) == pytest.approx((0.05 ** (1 / 30), 1.0))

    def test_it_covers_the_true_rate_as_often_as_it_says(self):
        from scipy.stats import binom

        count, good = 25, np.arange(26)
        low, high = np.transpose([of(k, count).confidence_interval(0.9) for k in good])
        covered = []
        for rate in np.linspace(0.01, 0.99, 99):
            weight = binom.pmf(good, count, rate)
            covered.append(weight[(low <= rate) & (rate <= high)].sum())
        assert min(covered) >= 0.9
        assert np.mean(covered) < 0.97  # exact, not merely wide

    @pytest.mark.parametrize("level", [0.0, 1.0, 95.0, float("nan")])
    def test_a_level_is_between_0_and_1(self, level):
        with pytest.raises(ValueError, match="level is"):
            of(1, 2).confidence_interval(level)


class TestColumns:
    def test_columns_are_the_numbers_drawn(self):
        found = tc.sweep(cases.noisy, PARAMETERS, 6, seed=1, executor=Inline())
        assert list(found.columns) == ["mass[0]", "mass[1]", "mass[2]", "delay"]
        assert np.array_equal(found.columns["mass[1]"], found.parameters["mass"][:, 1])
        assert found.parameters["mass"].shape == (6, 3)

    def test_ranks_follow_any_rise_and_any_fall(self):
        assert of(3, 9).rank_correlation("y") == {"x": pytest.approx(1.0)}

    def test_ranks_are_those_of_scipy_and_the_strongest_comes_first(self):
        from scipy.stats import spearmanr

        found = tc.sweep(cases.noisy, PARAMETERS, 40, seed=1, executor=Inline())
        ranks = found.rank_correlation("value")
        for name, rank in ranks.items():
            drawn = found.columns[name][found.completed]
            assert rank == pytest.approx(spearmanr(drawn, found.figure("value")).statistic)
        assert sorted(map(abs, ranks.values()), reverse=True) == list(map(abs, ranks.values()))

    def test_what_does_not_vary_has_no_rank(self):
        found = tc.sweep(
            cases.first_of_the_stream, {"same": tc.OneOf([2.0])}, 5, seed=1, executor=Inline()
        )
        assert found.rank_correlation("first") == {}
        with pytest.raises(ValueError, match="'y' has 2 values in 2 completed runs"):
            of(1, 2).rank_correlation("y")
        with pytest.raises(ValueError, match="name is 'z', expected one of 'y'"):
            of(1, 2).figure("z")


class TestText:
    def test_summary_has_rate_interval_and_failures(self):
        found = tc.sweep(cases.noisy, PARAMETERS, 40, seed=1, executor=Inline())
        text = found.summary()
        low, high = found.confidence_interval()
        assert f"{found.success_rate:.3f}, 95 % interval {low:.3f} to {high:.3f}" in text
        assert f"failed   {len(found.failures)} by ArithmeticError; run" in text
        assert found.table() in text
        assert "first_mass" in found.table()

    def test_a_report_without_runs_has_no_rate(self):
        empty = of(0, 0)
        assert empty.summary() == "case, seed 0: 0 of 0 runs done"
        assert empty.figures == empty.parameters == {}
        with pytest.raises(ValueError, match="no run is done"):
            _ = empty.success_rate
        with pytest.raises(ValueError, match="no run is done"):
            empty.confidence_interval()

    def test_it_can_be_pickled_and_hands_out_nothing_that_changes_it(self):
        found = of(2, 4)
        assert pickle.loads(pickle.dumps(found)) == found
        found.figures.clear()
        found.parameters.clear()
        assert list(found.figures) == ["y"]
        with pytest.raises(ValueError, match="read-only"):
            found.figures["y"][0] = 1.0
