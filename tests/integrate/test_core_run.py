"""Calls of the core over one span."""

from types import SimpleNamespace

import numpy as np

from tenscontrol.integrate.core_run import advance_in_core


def test_calls_that_end_early_ask_for_no_more_than_an_integer_holds():
    """Each of 500 calls ends at once, as one does whose memory for ends of steps is full."""
    budgets = []

    def advance(budget):
        budgets.append(budget)
        motion.is_over = len(budgets) == 500
        return motion.is_over

    motion = SimpleNamespace(
        progress=SimpleNamespace(stuck=0, time=0.0), state=np.zeros(4), advance=advance,
        is_over=False, is_paused=False, whole=np.zeros((4, 2)), ends=None,
    )  # fmt: skip
    span = advance_in_core(motion, lambda progress: None, None, None)
    assert span.whole.shape == (4, 2)
    assert budgets[0] < budgets[4] < max(budgets) <= 2**31 - 1
