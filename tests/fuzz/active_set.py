"""The active-set solver in C on many random programs, from random starts.

``python -m tests.fuzz.active_set --count 20000`` prints how many were solved, how many have no
solution, and the largest error of the conditions of an optimum. No point may keep the rows of a
program that the solver calls infeasible. Degenerate programs, rows twice, dependent rows, equations
and soft rows are among them; each is solved from nothing, from the answer to another program, and
from multipliers at random, with batches of rows of some sizes in turn.
"""

import argparse
from collections import Counter

import numpy as np

from tests.control.mpc.active_set_library import ActiveSetProgram
from tests.control.mpc.test_active_set import BATCHES, is_solvable, optimality, programs


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, statuses, worst, changes = np.random.default_rng(given.seed), Counter(), 0.0, 0
    for trial, (M, price, q, low, high) in enumerate(programs(rng, given.count)):
        program, starts = ActiveSetProgram(M, price, batch=BATCHES[trial // 4 % 3]), [None]
        starts += [10 ** rng.uniform(-2, 4) * rng.standard_normal(len(M)) for _ in range(2)]
        answers = []
        for start in starts:
            program.start(start)
            answers.append(program.solve(q, low, high))
        program.solve(q + 0.3 * rng.standard_normal(len(q)), low, high)
        answers.append(program.solve(q, low, high))
        found = {answer[0] for answer in answers}
        assert len(found) == 1, f"statuses depend on the start: {found}"
        statuses[answers[0][0]] += 1
        if found != {"ok"}:
            assert found == {"infeasible"}, found
            assert not is_solvable(M, price, low, high)
        for status, x, y, count in answers:
            changes = max(changes, count)
            if status == "ok":
                worst = max(worst, optimality(M, price, q, low, high, x, y))
    print(f"{dict(statuses)}, largest error {worst:.1e}, at most {changes} changes of the set")


if __name__ == "__main__":
    main()
