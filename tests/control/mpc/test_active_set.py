"""The active-set solver in C against its optimality conditions."""

import numpy as np
import pytest

from tests.control.mpc.active_set_library import ActiveSetProgram, library
from tests.control.mpc.optimum import is_feasible

pytestmark = pytest.mark.skipif(library() is None, reason="needs a C compiler")


def optimality(M, price, q, low, high, x, y):
    """Return the largest error of the conditions of an optimum, relative to q and y."""
    product = M @ x
    over = np.maximum(product - high, low - product)
    violation, side = np.maximum(over, 0.0), np.where(product > high, 1, -1)
    soft = np.isfinite(price)
    error = [np.abs(x + q + M.T @ y).max(), violation[~soft].max(initial=0.0)]
    with np.errstate(invalid="ignore"):
        paid = np.abs(side * y / price - 1 - violation)  # of violations
        held = np.maximum(np.abs(y) - price, 0.0)
        slack = np.where(y > 0, np.minimum(y, np.abs(high - product)), 0.0)
        slack += np.where(y < 0, np.minimum(-y, np.abs(product - low)), 0.0)
    violated = soft & (violation > 1e-9)
    error += [paid[violated].max(initial=0.0), held[soft & ~violated].max(initial=0.0)]
    error.append(slack[~violated].max(initial=0.0))
    return max(error) / max(1.0, np.abs(q).max(), np.abs(y).max())


def is_solvable(M, price, low, high):
    """Return whether a point keeps all hard rows."""
    hard = np.isinf(price)
    return is_feasible(M[hard], low[hard], high[hard])


def programs(rng, count):
    """Yield programs: general, with integers, with rows twice, and with dependent rows."""
    for trial in range(count):
        n, m, kind = rng.integers(1, 25), rng.integers(1, 60), trial % 4
        M = rng.standard_normal((m, n))
        if kind == 1:
            M = np.round(M)
        elif kind == 2:
            M[rng.integers(m, size=m // 2)] = M[rng.integers(m, size=m // 2)]
        elif kind == 3:
            inner = max(1, n // 3)
            M = M @ rng.standard_normal((n, inner)) @ rng.standard_normal((inner, n)) / n
        price = np.full(m, np.inf)
        soft = rng.random(m) < rng.random() * (trial % 3 > 0)
        price[soft] = 10 ** rng.uniform(-1, 4, soft.sum())
        middle = M @ np.round(rng.standard_normal(n)) + soft * rng.standard_normal(m)
        if rng.random() < 0.1:  # often without a solution
            middle += 0.5 * rng.standard_normal(m)
        below, above = rng.exponential(1, (2, m)) * (rng.random((2, m)) < 0.8)  # also equations
        if kind == 1:
            below, above = np.round(below), np.round(above)
        low, high = middle - below, middle + above
        low[rng.random(m) < 0.2], high[rng.random(m) < 0.2] = -np.inf, np.inf
        yield M, price, rng.standard_normal(n) * 10 ** rng.uniform(-1, 2), low, high


# Rows that are reached at once: one, fewer than are violated, and as it is, often more than those.
BATCHES = (1, 3, None)


@pytest.mark.parametrize("batch", BATCHES)
def test_answers_are_optimal(batch):
    rng = np.random.default_rng(3)
    sides, statuses = np.zeros(2, int), set()
    for M, price, q, low, high in programs(rng, 250):
        status, x, y, _ = ActiveSetProgram(M, price, stored=True, batch=batch).solve(q, low, high)
        again = ActiveSetProgram(M, price, batch=batch).solve(q, low, high)
        statuses.add(status)
        assert status == again[0]
        if status != "ok":
            assert status == "infeasible"
            assert not is_solvable(M, price, low, high)
            continue
        np.testing.assert_array_equal(x, again[1])  # where the rows are does not matter
        assert optimality(M, price, q, low, high, x, y) < 1e-14
        soft = np.isfinite(price) & (y != 0)
        sides += (np.abs(y[soft]) > price[soft]).sum(), (np.abs(y[soft]) < price[soft]).sum()
    assert sides.min() > 60  # multipliers on both sides of the price
    assert statuses == {"ok", "infeasible"}


@pytest.mark.parametrize("batch", BATCHES)
def test_any_start_gives_the_same_answer(batch):
    rng = np.random.default_rng(5)
    for M, price, q, low, high in programs(rng, 150):
        program = ActiveSetProgram(M, price, stored=True, batch=batch)
        status, x, _, _ = program.solve(q, low, high)
        starts = rng.standard_normal((2, len(M))) * (rng.random((2, len(M))) < 0.5)
        for start in (*starts, *(1e6 * starts)):
            program.start(start)
            found = program.solve(q, low, high)
            assert found[0] == status
            if status == "ok":
                np.testing.assert_allclose(found[1], x, atol=1e-9, rtol=1e-9)


def wide_program(rng):
    """Return a program of 120 unknowns, many of whose 400 rows the start violates."""
    n, m = 120, 400
    M = rng.standard_normal((m, n)) * 0.97 ** np.arange(n)
    price = np.where(rng.random(m) < 0.4, 10 ** rng.uniform(-1, 2, m), np.inf)
    middle = np.isinf(price) * (M @ rng.standard_normal(n))
    below, above = rng.exponential(1, (2, m))
    return M, price, 3 * rng.standard_normal(n), middle - below, middle + above


def test_many_rows_take_few_products():
    """Those of all rows; one by one there is one for each row that is added."""
    rng = np.random.default_rng(13)
    n, count, held = 400, 60, 40
    M, hard = rng.standard_normal((count, n)) / np.sqrt(n), np.full(count, np.inf)
    q, low = rng.standard_normal(n), np.full(count, -np.inf)
    high = -M @ q + np.where(np.arange(count) < held, -1, 1) * rng.uniform(1, 2, count)
    one, many = (ActiveSetProgram(M, hard, batch=batch) for batch in (1, None))
    changes = [program.solve(q, low, high)[3] for program in (one, many)]
    assert min(changes) >= held
    assert changes[1] < 1.2 * changes[0]
    assert one.products > held
    assert many.products <= 6
    assert many.batches < many.products
    assert many.reached <= count


def test_rows_of_a_batch_do_not_lead_astray():
    """Changes stay nearly as few, though most rows are added before all are known."""
    rng, changes, products = np.random.default_rng(17), np.zeros(2, int), np.zeros(2, int)
    for _ in range(4):
        M, price, *given = wide_program(rng)
        for i, batch in enumerate((1, None)):
            program = ActiveSetProgram(M, price, batch=batch)
            status, x, y, count = program.solve(*given)
            assert status == "ok"
            assert optimality(M, price, *given, x, y) < 1e-14
            changes[i] += count
            products[i] += program.products
    assert changes[1] < 1.25 * changes[0]
    assert products[1] < 0.1 * products[0]


def test_a_start_reaches_its_rows_in_batches():
    M, price, *given = wide_program(np.random.default_rng(19))
    program = ActiveSetProgram(M, price, stored=True)
    _, x, y, _ = program.solve(*given)
    program.start(y)
    again = program.solve(*given)
    np.testing.assert_allclose(again[1], x, rtol=0, atol=1e-12)
    assert again[3] == 0
    assert program.products == 1
    assert program.batches == 0
    program.solve(given[0] + 0.1, *given[1:])  # candidates come and go beside rows that stay
    assert program.solve(*given)[0] == "ok"


@pytest.mark.parametrize("stored", [False, True])
def test_a_sequence_follows_its_active_set(stored):
    rng = np.random.default_rng(7)
    n, m, count = 30, 80, 500
    M = np.tril(rng.standard_normal((m, n)), n // 2)  # rows of different lengths
    price = np.where(rng.random(m) < 0.5, 3.0, np.inf)
    ends = rng.standard_normal((2, n)) * 20
    low, high = -1 - rng.random(m), 1 + rng.random(m)
    program, cold, warm = ActiveSetProgram(M, price, stored), 0, 0
    for k in range(count):
        q = ends[0] + (ends[1] - ends[0]) * k / count
        high[3] = np.inf if k % 50 == 0 else 1.0  # a bound that comes and goes
        low[5] = high[5] if k % 70 == 0 else -1.0  # and an equation
        status, x, y, changes = program.solve(q, low, high)
        assert status == "ok"
        assert optimality(M, price, q, low, high, x, y) < 1e-14
        warm += changes
        if k % 100 == 50:
            fresh = ActiveSetProgram(M, price, stored).solve(q, low, high)
            np.testing.assert_allclose(fresh[1], x, atol=1e-12, rtol=1e-12)
            cold += fresh[3] * 100
    assert warm < 0.1 * cold


def test_nearly_dependent_rows_are_solved_exactly():
    rng = np.random.default_rng(11)
    for angle in (1e-3, 1e-5):
        M = rng.standard_normal((6, 10))
        M[3] = M[2] + angle * rng.standard_normal(10)
        right = M @ rng.standard_normal(10)
        status, x, _, _ = ActiveSetProgram(M, np.full(6, np.inf)).solve(np.zeros(10), right, right)
        assert status == "ok"
        np.testing.assert_allclose(M @ x, right, atol=1e-12)
        np.testing.assert_allclose(x, np.linalg.lstsq(M, right, rcond=None)[0], atol=1e-9 / angle)


def test_what_cannot_be_solved_is_said():
    M, hard = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]), np.full(3, np.inf)
    q, low, high = np.zeros(2), np.array([1.0, 1.0, -9.0]), np.array([9.0, 9.0, 9.0])

    def status(limit=100, stop_at=-1, **changed):
        given = {"q": q, "low": low, "high": high} | changed
        program = ActiveSetProgram(M, hard, limit=limit)
        found = program.solve(**given, stop_at=stop_at)[0]
        after, x, _, _ = program.solve(q, low, high) if limit > 1 else ("ok", q + 1, 0, 0)
        assert after == "ok"  # whatever was before
        np.testing.assert_allclose(x, 1.0, atol=1e-15)
        return found

    assert status() == "ok"
    assert status(high=np.array([9.0, 9.0, 1.5])) == "infeasible"
    assert status(high=np.array([0.0, 9.0, 9.0])) == "infeasible"  # crosses
    assert status(limit=1) == "out of iterations"
    assert status(stop_at=1) == "out of time"
    for bad in (np.nan, np.inf, -np.inf):
        assert status(q=np.array([bad, 0.0])) == "data not finite or too large"
    assert status(low=np.array([np.nan, 0, 0])) == "data not finite or too large"
    assert status(low=np.array([np.inf, 0, 0])) == "data not finite or too large"
    assert status(high=np.array([np.nan, 0, 0])) == "data not finite or too large"
