"""The buffered call gives what the plain call gives."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.evaluator import Evaluator
from tests.dynamics.scenes import any_motion, random_force_density


def test_it_gives_what_the_function_gives_call_after_call(prism):
    function = tc.Model(prism).acceleration
    evaluate = Evaluator(function)
    for seed in range(3):
        N, V = any_motion(prism, seed)
        gamma = random_force_density(prism, seed)
        np.testing.assert_array_equal(evaluate(N, V, gamma)[0], np.array(function(N, V, gamma)))
    assert evaluate.calls == 3


def test_it_takes_arrays_of_any_memory_layout(prism):
    evaluate = Evaluator(tc.Model(prism).acceleration)
    N, V = any_motion(prism, 0)
    gamma = random_force_density(prism, 0)
    plain = evaluate(N, V, gamma)[0].copy()
    spread = np.repeat(gamma, 2)[::2]
    np.testing.assert_array_equal(evaluate(np.asfortranarray(N), V.T.copy().T, spread)[0], plain)


def test_a_sparse_argument_is_refused():
    x = ca.SX.sym("x", ca.Sparsity.lower(3))
    with pytest.raises(ValueError, match="expected dense"):
        Evaluator(ca.Function("f", [x], [x]))
