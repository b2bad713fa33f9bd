"""The quadratic programs of linear MPC, solved by one solver after the other.

Run: ``python -m tests.benchmarks.qp_solvers``. The prism, 18 reduced states, 9 inputs, 0.02 s
samples, recovers from pushes with bounds active. Each sample is written with its states (sparse)
and with the states eliminated (dense), and goes to each solver by that solver's own interface,
updated in place and started from the last plan where it can be; qpOASES alone comes through CasADi,
which has it in its wheel. Beside them is the program along the stages. Times are of the processor,
as ratios to that of the stages of the same samples; elimination is not counted. Errors are those of
the planned inputs, in units of an input, beside the optimum by elimination of the rows that are
active, whose conditions are checked. Samples are put together by how many bounds are active in
them. Programs of NMPC are in ``nmpc_step``.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from time import process_time
from types import SimpleNamespace

import casadi as ca
import numpy as np
from scipy.sparse import csc_array, csc_matrix, triu, vstack

import tenscontrol as tc
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options
from tests.control.mpc.optimum import exact_optimum, point_of_inputs

HORIZONS = (10, 20, 40, 80)
ACTIVE = ((1, 2), (3, 10), (11, 60))  # least and most bounds active in a program
ADMM, INTERIOR = 1e-4, 1e-6  # tolerances; ADMM's that of the controllers
MOST = 20_000  # iterations


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, starts=3, samples=25, lengths=HORIZONS, slowest=1.0
    )  # s, of a program; a slower solver is stopped
    for horizon in given.lengths:
        report(horizon, recorded(horizon, given.starts, given.samples), given.slowest)


def recorded(horizon, starts, count):
    """Return the programs of closed loops, in order, and whether one begins a loop."""
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    most = 1.02 * float(plant.force_density.max())
    given = {"horizon": horizon, "sample_time": demo.SAMPLE, "max_force_density": most, "R": 1e-3}
    mpc = tc.MPC(plant, solver="stages", **given)
    sampled, program = mpc.law.design.sampled, mpc._program
    solve, samples = program.solve, []

    def timed(*given):
        began = process_time()
        answer = solve(*given)
        samples[-1].spent = process_time() - began
        return answer

    program.solve = timed
    for seed in range(starts):
        rng = np.random.default_rng(seed)
        size = len(sampled.transition)
        state = (0.01 + 0.03 * seed / max(starts - 1, 1)) * rng.normal(size=size)
        mpc.reset()
        for k in range(count):
            nodes = plant.to_nodes(state[:9])
            speeds = (plant.basis @ state[9:]).reshape(nodes.shape, order="F")
            whole = mpc.program(0.0, nodes, speeds)
            samples.append(SimpleNamespace(begins=k == 0, sparse=whole, dense=eliminated(whole)))
            command = mpc.command(0.0, nodes, speeds)
            if command.status != "ok":
                raise SystemExit(f"a program was not solved: {command}")
            samples[-1].x = point_of_inputs(whole, mpc.plan)
            off = command.value - plant.equilibrium_input
            state = sampled.transition @ state + sampled.by_input @ off
    return samples


def eliminated(whole):
    """Return a program of the inputs alone, and what gives the unknowns of the whole one."""
    states, A = slice(0, whole.first), whole.A.toarray()
    inverse = np.linalg.inv(A[states, states])
    start = np.zeros(A.shape[1])
    start[states] = inverse @ whole.l[states]
    matrix = np.vstack([-inverse @ A[states, whole.first :], np.eye(A.shape[1] - whole.first)])
    rows, P = A[whole.first :], whole.P
    known = rows @ start
    return SimpleNamespace(
        P=csc_array(matrix.T @ (P @ matrix)), q=matrix.T @ (whole.q + P @ start),
        A=csc_array(rows @ matrix), l=whole.l[whole.first :] - known,
        u=whole.u[whole.first :] - known, first=0, whole=lambda x: start + matrix @ x,
    )  # fmt: skip


def report(horizon, samples, slowest) -> None:
    found, notes = {"stages": along_stages(samples)}, {}
    for name, (form, make) in solvers().items():
        answer = run(form, make, samples, slowest)
        (notes if isinstance(answer, str) else found)[name] = answer
    programs = [each.sparse for each in samples]
    best = [
        exact_optimum(whole.P, whole.q, whole.A, whole.l, whole.u, each.x)
        for whole, each in zip(programs, samples, strict=True)
    ]
    unknown = slice(programs[0].first, None)
    active = np.array(
        [
            (np.minimum(whole.u - whole.A @ x, whole.A @ x - whole.l)[unknown] < 1e-7).sum()
            for whole, x in zip(programs, best, strict=True)
        ]
    )
    parts = [(active >= least) & (active <= most) for least, most in ACTIVE]
    heads = [f"{least} to {most} active ({part.sum()})" for (least, most), part in
             zip(ACTIVE, parts, strict=True)]  # fmt: skip
    print(
        f"\nhorizon {horizon}: {len(samples)} programs, {9 * horizon} inputs; time / stages', error"
    )
    print(" " * 24 + "".join(f"{head:>24s}" for head in heads))
    base = np.array([each[0] for each in found["stages"]])
    for name in ("stages", *solvers()):
        if name in notes:
            print(f"{name:24s} {notes[name]}")
            continue
        times = np.array([each[0] for each in found[name]])
        errors = np.array([np.abs(each[1] - exact)[unknown].max() for each, exact in
                           zip(found[name], best, strict=True)])  # fmt: skip
        cells = [
            f"{np.median(times[part]) / np.median(base[part]):13.2f} {errors[part].max():10.1e}"
            if part.any() else f"{'-':>24s}"
            for part in parts
        ]  # fmt: skip
        print(f"{name:24s}" + "".join(cells))
    for part, head in zip(parts, heads, strict=True):
        if part.any():
            print(f"stages, {head}: median {1e6 * np.median(base[part]):.0f} µs")


def along_stages(samples):
    """Return time and unknowns of each program along the stages."""
    return [(each.spent, each.x) for each in samples]


def run(form, make, samples, slowest):
    """Return time and unknowns of each program, or why there are none."""
    first = vars(samples[0])[form]
    solver = make(first)
    if isinstance(solver, str):
        return solver
    answers, guess = [], None
    for each in samples:
        program = vars(each)[form]
        began = process_time()
        answer = solver(program.q, program.l, program.u, None if each.begins else guess)
        spent = process_time() - began
        if answer is None:
            return f"failed after {len(answers)} programs"
        if spent > slowest:
            return f"stopped: a program took {spent:.1f} s"
        guess, x = answer, answer[0]
        answers.append((spent, x if form == "sparse" else program.whole(x)))
    return answers


def solvers():
    """Return form and maker of each solver, by name."""
    return {
        "OSQP, sparse": ("sparse", osqp),
        "PIQP multistage, sparse": ("sparse", piqp_multistage),
        "Clarabel, sparse": ("sparse", clarabel),
        "DAQP, dense": ("dense", daqp),
        "PIQP, dense": ("dense", piqp),
        "quadprog, dense": ("dense", quadprog),
        "qpOASES, dense": ("dense", qpoases),
        "Clarabel, dense": ("dense", clarabel),
    }


def missing(name):
    return "not installed (extra bench)" if importlib.util.find_spec(name) is None else None


def osqp(form):
    """As the controllers use it."""
    solver = OSQPSolver(form.P, form.A, ADMM, MOST)

    def solve(q, low, high, guess):
        answer = solver.solve(q, low, high, guess)
        return None if answer.x is None else (answer.x, answer.y)

    return solve


def daqp(form):
    """Updated in place, from the active set of its last answer."""
    if missing("daqp"):
        return missing("daqp")
    import daqp

    P, A, state = form.P.toarray(), form.A.toarray(), {}

    def solve(q, low, high, guess):
        sense = np.zeros(len(low), np.intc)
        if "model" not in state:
            state["model"] = daqp.Model()
            state["model"].setup(P, q, A, high, low, sense)
            state["model"].settings = {"primal_tol": 1e-10}
        else:
            y = state["y"] if guess is not None else np.zeros(len(low))
            sense[y > 1e-12], sense[y < -1e-12] = 1, 3
            state["model"].update(f=q, bupper=high, blower=low, sense=sense)
        x, _, flag, info = state["model"].solve()
        if flag != 1:
            return None
        state["y"] = info["lam"]
        return x, info["lam"]

    return solve


def piqp_multistage(form):
    """With bounds of unknowns as rows; equations are apart."""
    if missing("piqp"):
        return missing("piqp")
    import piqp

    solver, state = piqp.SparseSolver(), {"fresh": True}
    settings = solver.settings
    settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    settings.eps_abs = settings.eps_rel = INTERIOR
    P, A, rows = csc_matrix(form.P), form.A.tocsr(), slice(form.first, None)
    equations, others = csc_matrix(A[: form.first]), csc_matrix(A[rows])

    def solve(q, low, high, guess):
        given = {"c": q, "b": low[: form.first], "h_l": low[rows], "h_u": high[rows]}
        if state["fresh"]:
            solver.setup(P, A=equations, G=others, **given)
            state["fresh"] = False
        else:
            solver.update(**given)
        if solver.solve() != piqp.PIQP_SOLVED:
            return None
        result = solver.result
        return np.array(result.x), np.concatenate([result.y, result.z_u - result.z_l])

    return solve


def piqp(form):
    """Updated in place."""
    if missing("piqp"):
        return missing("piqp")
    import piqp

    solver, state = piqp.DenseSolver(), {"fresh": True}
    settings = solver.settings
    settings.eps_abs = settings.eps_rel = INTERIOR
    P, A = np.asfortranarray(form.P.toarray()), np.asfortranarray(form.A.toarray())

    def solve(q, low, high, guess):
        if state["fresh"]:
            solver.setup(P, q, None, None, A, low, high)
            state["fresh"] = False
        else:
            solver.update(c=q, h_l=low, h_u=high)
        if solver.solve() != piqp.PIQP_SOLVED:
            return None
        return np.array(solver.result.x), np.array(solver.result.z_u - solver.result.z_l)

    return solve


def quadprog(form):
    """With the Hessian factorized once; it has no start."""
    if missing("quadprog"):
        return missing("quadprog")
    import quadprog

    inverse = np.linalg.inv(np.linalg.cholesky(form.P.toarray())).T
    A = form.A.toarray()
    both = np.asfortranarray(np.vstack([A, -A]).T)

    def solve(q, low, high, guess):
        x, *_, y, _ = quadprog.solve_qp(
            inverse.copy(), -q, both, np.concatenate([low, -high]), factorized=True
        )
        return x, y[len(low) :] - y[: len(low)]

    return solve


def qpoases(form):
    """By CasADi's plug-in, through its buffers, from its last answer."""
    if not ca.has_conic("qpoases"):
        return "not in the wheel of CasADi"
    P, A = csc_matrix(form.P), csc_matrix(form.A)
    P.sort_indices(), A.sort_indices()
    patterns = {"h": P, "a": A}
    solver = ca.conic(
        "qp", "qpoases",
        {key: ca.Sparsity(*m.shape, m.indptr.tolist(), m.indices.tolist())
         for key, m in patterns.items()},
        {"printLevel": "none", "error_on_fail": False},
    )  # fmt: skip
    last = {}

    def solve(q, low, high, guess):
        given = {"h": P.data, "g": q, "a": A.data, "lba": low, "uba": high,
                 "lbx": -np.inf, "ubx": np.inf, **last}  # fmt: skip
        arguments = [
            ca.DM(solver.sparsity_in(i), given.get(solver.name_in(i), 0.0))
            for i in range(solver.n_in())
        ]
        out = dict(zip(solver.name_out(), solver.call(arguments), strict=True))
        if not solver.stats()["success"]:
            return None
        x, lam_a, lam_x = (out[key].full().ravel() for key in ("x", "lam_a", "lam_x"))
        last.update(x0=x, lam_a0=lam_a, lam_x0=lam_x)
        return x, lam_a

    return solve


def clarabel(form):
    """Set up anew for each program."""
    if missing("clarabel"):
        return missing("clarabel")
    import clarabel

    P, A = csc_matrix(triu(form.P)), form.A.tocsr()
    settings = clarabel.DefaultSettings()
    settings.verbose = False

    def solve(q, low, high, guess):
        equal, above, below = low == high, (low < high) & (high < np.inf), low < high
        below = below & (low > -np.inf)
        rows = csc_matrix(vstack([A[equal], A[above], -A[below]]))
        bounds = np.concatenate([high[equal], high[above], -low[below]])
        cones = [clarabel.ZeroConeT(int(equal.sum()))] if equal.any() else []
        cones.append(clarabel.NonnegativeConeT(int(above.sum() + below.sum())))
        result = clarabel.DefaultSolver(P, q, rows, bounds, cones, settings).solve()
        if str(result.status) != "Solved":
            return None
        y, z = np.zeros(len(low)), np.array(result.z)
        first, second = equal.sum(), equal.sum() + above.sum()
        y[equal], y[above] = z[:first], z[first:second]
        y[below] -= z[second:]
        return np.array(result.x), y

    return solve


if __name__ == "__main__":
    main()
