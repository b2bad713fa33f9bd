"""The quadratic programs of linear MPC, solved by one solver after the other.

Run: ``python -m tests.benchmarks.qp_solvers``. The prism, 18 reduced states, 9 inputs, 0.02 s
samples, recovers from pushes with bounds active. Each sample is written the condensed way (dense)
and the sparse way, and goes to each solver by that solver's own interface, updated in place and
started from the last plan where it can be; qpOASES alone comes through CasADi, which has it in its
wheel. Times are of the processor, as ratios to DAQP's of the same samples. Errors are those of the
planned inputs, beside the answer that meets the optimality conditions best, in units of an input.
Samples are put together by how many bounds are active in them. Programs of NMPC are in
``nmpc_step``.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from time import process_time

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix, triu, vstack

import tenscontrol as tc
from tenscontrol.control.mpc.solvers.daqp_adapter import DAQPSolver
from tenscontrol.control.mpc.solvers.osqp_adapter import OSQPSolver
from tenscontrol.control.mpc.solvers.piqp_adapter import PIQPSolver
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options
from tests.control.mpc.test_linear import kkt_residual

HORIZONS = (10, 20, 40, 80)
ACTIVE = ((1, 2), (3, 10), (11, 60))  # least and most bounds active in a program
ADMM, INTERIOR = 1e-4, 1e-6  # tolerances; ADMM's that of the controllers
MOST = 20_000  # iterations


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, starts=3, samples=25, lengths=HORIZONS, slowest=1.0
    )  # s, of a program; a slower solver is stopped
    for horizon in given.lengths:
        samples = recorded(horizon, given.starts, given.samples)
        report(horizon, samples, given.slowest)


def recorded(horizon, starts, count):
    """Return the programs of closed loops, in order, and whether one begins a loop."""
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    most = 1.02 * float(plant.force_density.max())
    given = {"horizon": horizon, "sample_time": demo.SAMPLE, "max_force_density": most, "R": 1e-3}
    mpc = tc.MPC(plant, form="condensed", solver="daqp", **given)
    law = mpc.law
    forms = {"condensed": law.form, "sparse": Sparse(law.design.problem)}
    transition, by_input = law.design.sampled.transition, law.design.sampled.by_input
    programs = []
    for seed in range(starts):
        rng = np.random.default_rng(seed)
        state = (0.01 + 0.03 * seed / max(starts - 1, 1)) * rng.normal(size=len(transition))
        mpc.reset()
        for k in range(count):
            data = law.stage_data(law.preview(0.0), None)
            given = {name: form.vectors(state, data, np.zeros(9)) for name, form in forms.items()}
            programs.append((k == 0, state, data, given))
            nodes = plant.to_nodes(state[:9])
            speeds = (plant.basis @ state[9:]).reshape(nodes.shape, order="F")
            command = mpc.command(0.0, nodes, speeds)
            if command.status != "ok":
                raise SystemExit(f"a program was not solved: {command}")
            state = transition @ state + by_input @ (command.value - plant.equilibrium_input)
    return forms, programs


def report(horizon, samples, slowest) -> None:
    forms, programs = samples
    found, notes = {}, {}
    for name, (form, make) in solvers().items():
        answer = run(forms[form], form, make, programs, slowest)
        (notes if isinstance(answer, str) else found)[name] = answer
    best = [min(part, key=lambda each: each[1])[2] for part in zip(*found.values(), strict=True)]
    active = np.array([each[3] for each in found["DAQP, condensed"]])
    parts = [(active >= least) & (active <= most) for least, most in ACTIVE]
    heads = [f"{least} to {most} active ({part.sum()})" for (least, most), part in
             zip(ACTIVE, parts, strict=True)]  # fmt: skip
    print(
        f"\nhorizon {horizon}: {len(programs)} programs, {9 * horizon} inputs; time / DAQP, error"
    )
    print(" " * 24 + "".join(f"{head:>24s}" for head in heads))
    base = np.array([each[0] for each in found["DAQP, condensed"]])
    for name in solvers():
        if name in notes:
            print(f"{name:24s} {notes[name]}")
            continue
        times = np.array([each[0] for each in found[name]])
        errors = np.array([np.abs(each[2] - exact).max() for each, exact in
                           zip(found[name], best, strict=True)])  # fmt: skip
        cells = [
            f"{np.median(times[part]) / np.median(base[part]):13.2f} {errors[part].max():10.1e}"
            if part.any() else f"{'-':>24s}"
            for part in parts
        ]  # fmt: skip
        print(f"{name:24s}" + "".join(cells))
    for part, head in zip(parts, heads, strict=True):
        if part.any():
            print(f"DAQP, {head}: median {1e6 * np.median(base[part]):.0f} µs")


def run(form, kind, make, programs, slowest):
    """Return time, residual, inputs and active bounds of each program, or why there are none."""
    solver = make(form)
    if isinstance(solver, str):
        return solver
    answers, guess = [], None
    for begins, state, data, given in programs:
        q, low, high = given[kind]
        guess = None if begins else guess
        began = process_time()
        answer = solver(q, low, high, guess)
        spent = process_time() - began
        if answer is None:
            return f"failed after {len(answers)} programs"
        if spent > slowest:
            return f"stopped: a program took {spent:.1f} s"
        x, y = answer
        guess = form.shifted(x, y)
        far = (np.clip(bound, -1e9, 1e9) for bound in (low, high))
        residual = kkt_residual(form.P, q, form.A, *far, x, y)
        inputs = form.inputs(x, state, data) / form_level(form)
        answers.append((spent, residual, inputs, int((np.abs(y[low < high]) > 1e-9).sum())))
    return answers


def form_level(form):
    return (form.limits if isinstance(form, Sparse) else form._limits).level


def solvers():
    """Return form and maker of each solver, by name."""
    return {
        "DAQP, condensed": ("condensed", family(DAQPSolver, ADMM)),
        "OSQP, condensed": ("condensed", family(OSQPSolver, ADMM)),
        "PIQP, condensed": ("condensed", piqp),
        "quadprog, condensed": ("condensed", quadprog),
        "qpOASES, condensed": ("condensed", qpoases),
        "Clarabel, condensed": ("condensed", clarabel),
        "OSQP, sparse": ("sparse", family(OSQPSolver, ADMM)),
        "PIQP multistage, sparse": ("sparse", family(PIQPSolver, INTERIOR, "piqp")),
        "Clarabel, sparse": ("sparse", clarabel),
    }


def missing(name):
    return "not installed (extra bench)" if importlib.util.find_spec(name) is None else None


def family(kind, tolerance, package=None):
    """Return what makes a solver of the package, as the controllers use it."""

    def make(form):
        if package is not None and missing(package):
            return missing(package)
        solver = kind(form.P, form.A, tolerance, MOST)

        def solve(q, low, high, guess):
            answer = solver.solve(q, low, high, guess)
            return None if answer.x is None else (answer.x, answer.y)

        return solve

    return make


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
