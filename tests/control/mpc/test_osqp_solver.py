"""OSQP behind the interface of solvers of quadratic programs: optimality, statuses, resets."""

import os
import pickle
import signal
import threading
from time import perf_counter

import numpy as np
import pytest
from scipy.sparse import csc_array

from tenscontrol.control import Status
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tests.control.mpc.test_linear import kkt_residual

FREE, HARD, SOFT = 12, 8, 5


def make(P, A, most=20_000, tolerance=1e-9):
    return OSQPSolver(csc_array(P), csc_array(A), tolerance, most)


def program(seed):
    """Matrices of a random program with rows that are soft on both sides, and their price."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(FREE, FREE))
    P = np.diag(np.r_[np.ones(FREE), rng.uniform(0.1, 1, SOFT)])
    if seed % 2:
        P[:FREE, :FREE] = root @ root.T
    rows, each = rng.normal(size=(HARD + SOFT, FREE)), np.eye(SOFT)
    A = np.block([
        [rows[:HARD], np.zeros((HARD, SOFT))],
        [rows[HARD:], -each],
        [rows[HARD:], each],
        [np.zeros((SOFT, FREE)), each],
    ])  # fmt: skip
    return P, A, P.diagonal()[FREE:].copy()


def vectors(price, rng):
    high, soft, none = rng.uniform(0.1, 1, HARD), rng.uniform(0.05, 0.2, SOFT), np.zeros(SOFT)
    infinite = np.full(SOFT, np.inf)
    q = np.r_[3 * rng.normal(size=FREE), price]
    return q, np.r_[-high, -infinite, -soft, none], np.r_[high, soft, infinite, infinite]


@pytest.mark.parametrize("seed", range(4))
def test_answers_are_optimal(seed):
    P, A, price = program(seed)
    solver, rng = make(P, A), np.random.default_rng(seed)
    violated = 0
    for k in range(6):
        q, low, high = vectors(price, rng)
        if k == 2:
            low[0] = high[0]  # an equation now, and a bound again later
        if k == 4:
            q[FREE:] *= 2
        if k == 5:
            low[-1] = -0.1  # not the bound of a violation
        if k == 3:
            A = A * np.where(np.arange(len(A)) == 1, 1.5, 1.0)[:, None]
            solver.update(csc_array(A).data)
        answer = solver.solve(q, low, high)
        assert answer.status is Status.OK
        bounds = (np.clip(bound, -1e9, 1e9) for bound in (low, high))
        error = kkt_residual(P, q, A, *bounds, answer.x, answer.y)
        assert error < 1e-12
        violated += (answer.x[FREE:] > 1e-3).sum()
    assert violated > 2


@pytest.mark.parametrize("tolerance", [1e-4, 1.0])
def test_answers_are_exact_whatever_the_tolerance(tolerance):
    """From other bounds than those that are active, and with a finer tolerance where it needs."""
    exact = 0
    for seed in range(40):
        P, A, price = program(seed)
        q, low, high = vectors(price, np.random.default_rng(seed))
        answer = make(P, A, tolerance=tolerance).solve(q, low, high)
        bounds = (np.clip(bound, -1e9, 1e9) for bound in (low, high))
        exact += kkt_residual(P, q, A, *bounds, answer.x, answer.y) < 1e-12
    assert exact == 40


def test_bounds_that_depend_on_one_another_are_kept_exactly():
    """The corner (1, 2) is on five rows, one of them twice: min |x − (3, 3)|²."""
    rows = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [-2.0, 1.0]])
    high = np.array([1.0, 2.0, 3.0, 1.0, 0.0])
    answer = make(np.eye(2), rows, tolerance=1e-3).solve(-np.full(2, 3.0), np.full(5, -9.0), high)
    np.testing.assert_allclose(answer.x, [1.0, 2.0], rtol=0, atol=1e-14)
    assert answer.y.min() >= 0
    np.testing.assert_allclose(rows.T @ answer.y, [2.0, 1.0], rtol=0, atol=1e-12)


def test_reset_and_pickle_leave_a_fresh_solver():
    P, A, price = program(0)
    used, rng = make(P, A), np.random.default_rng(7)
    given = vectors(price, rng)
    for _ in range(3):
        used.solve(*vectors(price, rng))
    used.update(csc_array(A).data * 1.1)
    used.solve(*vectors(price, rng))
    copied, fresh = pickle.loads(pickle.dumps(used)), make(P, A)
    used.reset()
    first = fresh.solve(*given)
    for solver in (used, copied):
        answer = solver.solve(*given)
        np.testing.assert_array_equal(answer.x, first.x)
        np.testing.assert_array_equal(answer.y, first.y)


def test_data_that_are_refused_leave_nothing_behind():
    P, A, price = program(1)
    used, fresh = make(P, A), make(P, A)
    q, low, high = vectors(price, np.random.default_rng(1))
    used.solve(q, low, high)
    broken = q.copy()
    broken[0] = np.nan
    assert used.solve(broken, low, high).status is Status.BAD_DATA
    assert used.solve(q, high, low).status in {Status.BAD_DATA, Status.INFEASIBLE}
    assert used.solve(q, low, high, deadline=perf_counter() - 1).status is Status.OUT_OF_TIME
    contrary = A.copy()
    contrary[1] = contrary[0]
    used.update(csc_array(np.where(A != 0, contrary, 0.0)).data[: csc_array(A).nnz])
    crossed = low.copy(), high.copy()
    crossed[0][1], crossed[1][1] = high[0] + 0.1, high[0] + 0.2
    answer = used.solve(q, *crossed)
    assert (answer.status, answer.x) == (Status.INFEASIBLE, None)
    used.reset()
    used.update(csc_array(A).data)
    again, first = (solver.solve(q, low, high) for solver in (used, fresh))
    np.testing.assert_allclose(again.x, first.x, atol=1e-7)
    with pytest.raises(ValueError, match=r"q has shape \(3,\), expected \(17,\)"):
        used.solve(q[:3], low, high)
    for values in (np.ones(3), np.full(csc_array(A).nnz, np.nan)):
        with pytest.raises(ValueError, match="finite values, got shape"):
            used.update(values)


def test_too_few_iterations():
    P, A, price = program(1)
    answer = make(P, A, most=1).solve(*vectors(price, np.random.default_rng(1)))
    assert (answer.status, answer.x) == (Status.OUT_OF_ITERATIONS, None)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_reaches_the_caller():
    """The key is pressed while a program is solved again and again."""
    P, A, price = program(0)
    solver, rng = make(P, A), np.random.default_rng(0)
    given = vectors(price, rng)
    main = os.getpid()
    timer = threading.Timer(0.05, os.kill, (main, signal.SIGINT))

    def again():
        timer.start()
        for _ in range(1_000_000):
            solver.solve(*given)

    with pytest.raises(KeyboardInterrupt):
        again()
    timer.join()
    assert solver.solve(*given).status is Status.OK
