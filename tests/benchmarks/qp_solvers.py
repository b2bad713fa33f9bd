"""The quadratic programs of closed loops, solved by one solver after the other.

Run: ``python -m tests.benchmarks.qp_solvers``. The prism, 18 reduced states, 9 inputs, horizon
20, 0.02 s samples, recovers from pushes with bounds active. Programs of three kinds are recorded
from the loops as they run: condensed MPC (dense, limits alone change), sparse MPC (large, limits
alone change) and NMPC (large, A changes too). Each solver gets the same matrices and vectors and
starts from its last answer where it can. All answers go through one independent measure: the
optimality conditions in the units of the program, and the objective beside that of the answers that
meet the conditions best.
Tolerances are set so that every solver gets to about the same; where one does better or worse, the
table says so. Times are ratios of one run on one machine, programs in the same order, of the
processor, since a busy machine adds to the clock. What is not in the wheel of CasADi, or not
installed, is listed as such. Two plug-ins of CasADi 3.8 are left out: fatrop prints all
data of a program and fails an assertion of its own, ipqp solves the condensed program alone and
warns without end.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import casadi as ca
import numpy as np
from scipy.sparse import csc_array, csc_matrix, triu

import tenscontrol as tc
from tenscontrol.control import NMPC
from tenscontrol.control.mpc import OSQPSolver
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options
from tests.control.mpc.nmpc_oracle import closed_loop_cost
from tests.control.mpc.test_linear import kkt_residual

LIMIT = 33.0  # N/m, little above the prestress, so that bounds are met
STARTS, SAMPLES, HORIZON = 2, 15, 20
ADMM, INTERIOR = 1e-4, 1e-5  # tolerances; ADMM's that of the controllers
MOST = 20_000  # iterations
PLUGINS = ("osqp", "hpipm", "qrqp", "qpoases", "proxqp", "daqp", "highs")
SLOWEST = 300  # a solver is stopped whose program takes so many times ours


@dataclass
class Recorded:
    """Programs of one pattern."""

    name: str
    P: csc_array
    A: csc_array
    horizon: int
    changing: bool  # whether the values of A change
    stages: bool  # whether it is a trajectory: z_1 … z_N, u_0 … u_{N−1}
    data: list[tuple[np.ndarray, ...]]  # values of A, q, l, u, and the guess to start from

    def matrix(self, values):
        return csc_array((values, self.A.indices, self.A.indptr), shape=self.A.shape)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, starts=STARTS, samples=SAMPLES, horizon=HORIZON, slowest=SLOWEST
    )
    for recorded in recordings(given.starts, given.samples, given.horizon):
        report(recorded, given.slowest)


def recordings(starts, samples, horizon):
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    nmpc = NMPC(plant, horizon=horizon, sample_time=demo.SAMPLE, max_force_density=LIMIT)
    controllers = {
        "condensed MPC": tc.MPC(
            plant,
            horizon=horizon,
            sample_time=demo.SAMPLE,
            max_force_density=LIMIT,
            form="condensed",
        ),
        "sparse MPC": tc.MPC(
            plant, horizon=horizon, sample_time=demo.SAMPLE, max_force_density=LIMIT, form="sparse"
        ),
        "NMPC": nmpc,
    }
    for name, controller in controllers.items():
        nonlinear = name == "NMPC"
        owner, what = (nmpc._plan, "solver") if nonlinear else (controller, "_solver")
        program = getattr(owner, what)
        kept = Recorder(program)
        setattr(owner, what, kept)
        for seed in range(starts):
            rng = np.random.default_rng(seed)
            state = np.r_[0.05 * rng.normal(size=9), 0.25 * rng.normal(size=9)]
            closed_loop_cost(nmpc, controller, nmpc.sampled, state, samples)
        setattr(owner, what, program)
        form = owner.form if nonlinear else controller.law.form
        P, A = form.P, form.A.copy()
        A.sort_indices()
        data = [(A.data if values is None else values, *rest) for values, *rest in kept.data]
        yield Recorded(name, P, A, horizon, nonlinear, name != "condensed MPC", data)


class Recorder:
    """A program that notes what it is given."""

    def __init__(self, program):
        self._program, self._values, self.data = program, None, []

    def update(self, values):
        self._values = values.copy()
        self._program.update(values)

    def solve(self, q, l, u, start=None, **options):  # noqa: E741
        self.data.append((self._values, q.copy(), l.copy(), u.copy(), start))
        return self._program.solve(q, l, u, start, **options)

    def __getattr__(self, name):
        return getattr(self._program, name)


def report(recorded, slowest) -> None:
    solvers = {
        "ours (OSQP, in place)": Ours,
        "OSQP, set up anew": Cold,
        **{f"CasADi {name}": plugin(name) for name in PLUGINS},
        "PIQP, sparse": piqp_with("sparse_ldlt"),
        "PIQP, multistage": piqp_with("sparse_multistage"),
    }  # fmt: skip
    rows, size = recorded.A.shape
    print(
        f"\n{recorded.name}: {len(recorded.data)} programs, {size} unknowns, {rows} rows, "
        f"{recorded.A.nnz} entries of A"
    )
    found, notes, most = {}, {}, np.inf
    for name, make in solvers.items():
        answer = run(recorded, make, most)
        if not found:
            most = slowest * np.median(answer["time"])
        if isinstance(answer, str):
            notes[name] = answer
        else:
            found[name] = answer
    best = min(found.values(), key=lambda each: each["residual"].max())["objective"]
    unit = np.abs(best).max()
    base = np.median(found["ours (OSQP, in place)"]["time"])
    print(f"bounds active in a program: {found['ours (OSQP, in place)']['active']:.1f} on average")
    print("                         time / ours   p99 / our   iterations  conditions   objective")
    print("                            median      median       mean        worst        error")
    for name in solvers:
        if name in notes:
            print(f"{name:24s} {notes[name]}")
            continue
        each = found[name]
        median, late = np.median(each["time"]), np.percentile(each["time"], 99)
        work = np.mean(each["iterations"])
        print(
            f"{name:24s} {median / base:10.2f} {late / base:12.2f} "
            f"{work if np.isfinite(work) else float('nan'):12.1f} {each['residual'].max():11.1e} "
            f"{np.abs(each['objective'] - best).max() / unit:12.1e}"
        )


def run(recorded, make, most):
    """Return times and errors of all programs, or why there are none."""
    solver = make(recorded)
    if isinstance(solver, str):
        return solver
    times, iterations, residuals, objectives, active = [], [], [], [], []
    for values, *vectors, start in recorded.data:
        began = process_time()
        answer = solver.solve(values, *vectors, start)
        times.append(process_time() - began)
        if isinstance(answer, str):
            return f"failed after {len(iterations)} programs: {answer}"
        x, y, work = answer
        if times[-1] > most:
            return f"stopped: a program took more than {1e3 * most:.0f} ms"
        iterations.append(work)
        far = [np.clip(bound, -1e9, 1e9) for bound in vectors[1:]]
        residuals.append(kkt_residual(recorded.P, vectors[0], recorded.matrix(values), *far, x, y))
        objectives.append(0.5 * x @ (recorded.P @ x) + vectors[0] @ x)
        active.append((np.abs(y[vectors[1] < vectors[2]]) > 1e-3).sum())
    return {
        "time": times[1:],  # the first sets up
        "iterations": iterations,
        "residual": np.array(residuals),
        "objective": np.array(objectives),
        "active": np.mean(active),
    }


class Ours:
    """The adapter of the package, as the controllers use it."""

    def __init__(self, recorded):
        self._program = OSQPSolver(recorded.P, recorded.A, ADMM, MOST, equations=recorded.changing)
        self._changing = recorded.changing

    def solve(self, values, q, l, u, start):  # noqa: E741
        if self._changing:
            self._program.update(values)
        answer = self._program.solve(q, l, u, start)
        return answer.status.value if answer.x is None else (answer.x, answer.y, answer.iterations)


class Cold:
    """OSQP with its own settings, set up anew for each program."""

    def __init__(self, recorded):
        self._recorded, self._P = recorded, csc_matrix(triu(recorded.P))

    def solve(self, values, q, l, u, start):  # noqa: E741
        import osqp

        solver = osqp.OSQP()
        solver.setup(
            P=self._P, q=q, A=csc_matrix(self._recorded.matrix(values)), l=l, u=u, verbose=False,
            eps_abs=ADMM, eps_rel=ADMM, max_iter=MOST,
        )  # fmt: skip
        result = solver.solve(raise_error=False)
        done = result.info.status == "solved"
        return (result.x, result.y, result.info.iter) if done else result.info.status


class Split:
    """A program as equations and bounds of unknowns, in the order of stages: u_0, z_1, u_1 … z_N.

    A condensed program has neither: all its rows stay as they are.
    """

    def __init__(self, recorded):
        self.recorded, (rows, size) = recorded, recorded.A.shape
        s, a = 18, 9
        self.rows = recorded.horizon * s if recorded.stages else rows
        self.order = np.arange(size)
        if recorded.stages:
            states, inputs = np.split(self.order, [recorded.horizon * s])
            self.order = np.hstack([inputs.reshape(-1, a), states.reshape(-1, s)]).ravel()
        self.bounded = self.order >= self.rows if recorded.stages else np.zeros(size, bool)
        self.P = csc_matrix(recorded.P.tocsc()[self.order][:, self.order])
        # Numbers tell where each value of A goes; equations are z⁺ = A z + B u + c.
        numbered = recorded.matrix(np.arange(1.0, recorded.A.nnz + 1))
        self.A = csc_matrix(numbered[: self.rows][:, self.order])
        self.A.sort_indices()
        self.taken = self.A.data.astype(int) - 1
        self.sign = -1.0 if recorded.stages else 1.0

    def parts(self, values, q, l, u):  # noqa: E741
        """Return values of A, q, bounds of its rows and bounds of the unknowns."""
        infinite = np.full(len(q), np.inf)
        low, high = -infinite, infinite.copy()
        low[self.bounded], high[self.bounded] = l[self.rows :], u[self.rows :]
        rows = sorted((self.sign * l[: self.rows], self.sign * u[: self.rows]),
                      key=lambda part: part.sum())  # fmt: skip
        return self.sign * values[self.taken], q[self.order], *rows, low, high

    def joined(self, x, y_rows, y_bounds):
        """Return x and y of the program as recorded."""
        back = np.empty_like(x)
        back[self.order] = x
        return back, np.concatenate([self.sign * y_rows, y_bounds[self.bounded]])


def plugin(name):
    """Return what makes a solver of CasADi's plug-in, or says why not."""
    options = {
        "osqp": {"osqp": {"eps_abs": ADMM, "eps_rel": ADMM, "max_iter": MOST, "verbose": False}},
        "hpipm": {"hpipm": {f"res_{k}_max": INTERIOR for k in "gbdm"}},
        "qrqp": {"print_iter": False, "print_header": False, "print_info": False},
        "qpoases": {"printLevel": "none"},
        "proxqp": {"proxqp": {"eps_abs": INTERIOR, "eps_rel": 0.0, "verbose": False}},
        "highs": {"highs": {"output_flag": False}},
    }.get(name, {})

    def make(recorded):
        if not ca.has_conic(name):
            return "not in the wheel of CasADi"
        extra = {}
        if name == "hpipm":
            if not recorded.stages:
                return "takes trajectories only"
            N = recorded.horizon
            extra = {"N": N, "nx": [0] + [18] * N, "nu": [9] * N + [0], "ng": [0] * (N + 1)}
        return Plugin(name, recorded, {**options, **extra, "error_on_fail": False})

    return make


class Plugin:
    """A plug-in of CasADi, called through its buffer, with its last answer as a start."""

    def __init__(self, name, recorded, options):
        self._split = split = Split(recorded)
        pattern = ca.Sparsity(*split.A.shape, split.A.indptr.tolist(), split.A.indices.tolist())
        hessian = ca.Sparsity(*split.P.shape, split.P.indptr.tolist(), split.P.indices.tolist())
        self._solver = ca.conic("qp", name, {"h": hessian, "a": pattern}, options)
        self._last = [np.zeros(split.P.shape[0])] * 2 + [np.zeros(split.rows)]

    def solve(self, values, q, l, u, start):  # noqa: E741
        A, q, low, high, least, most = self._split.parts(values, q, l, u)
        x0, lam_x0, lam_a0 = self._last
        given = {"h": self._split.P.data, "g": q, "a": A, "lba": low, "uba": high, "lbx": least,
                 "ubx": most, "x0": x0, "lam_x0": lam_x0, "lam_a0": lam_a0}  # fmt: skip
        solver = self._solver
        arguments = []
        for i in range(solver.n_in()):
            value = given.get(solver.name_in(i), np.zeros(solver.nnz_in(i)))
            arguments.append(ca.DM(solver.sparsity_in(i), value))
        out = dict(zip(solver.name_out(), solver.call(arguments), strict=True))
        stats = solver.stats()
        if not stats["success"]:
            return str(stats["return_status"])
        self._last = [np.array(out[name].nonzeros()) for name in ("x", "lam_x", "lam_a")]
        x, lam_x, lam_a = (out[name].full().ravel() for name in ("x", "lam_x", "lam_a"))
        self._last = [x, lam_x, lam_a]
        count = stats["iter_count"] if stats.get("iter_count", -1) > 0 else np.nan
        return *self._split.joined(x, lam_a, lam_x), count


def piqp_with(kind):
    """Return what makes PIQP with one of its factorizations, or says why not."""

    def make(recorded):
        if importlib.util.find_spec("piqp") is None:
            return "not installed (extra bench)"
        return Piqp(recorded, kind)

    return make


class Piqp:
    """PIQP, updated in place."""

    def __init__(self, recorded, kind):
        import piqp

        self._split, self._solver = Split(recorded), piqp.SparseSolver()
        settings = self._solver.settings
        settings.kkt_solver = getattr(piqp.KKTSolver, kind)
        settings.eps_abs = settings.eps_duality_gap_abs = INTERIOR
        settings.eps_rel = settings.eps_duality_gap_rel = 0.0
        self._solved, self._fresh = piqp.PIQP_SOLVED, True

    def solve(self, values, q, l, u, start):  # noqa: E741
        split, solver = self._split, self._solver
        data, q, low, high, least, most = split.parts(values, q, l, u)
        matrix = csc_matrix((data, split.A.indices, split.A.indptr), shape=split.A.shape)
        given = {"c": q, "x_l": least, "x_u": most}
        stages = split.recorded.stages
        given |= {"b": low} if stages else {"h_l": low, "h_u": high}
        if self._fresh or split.recorded.changing:
            given["A" if stages else "G"] = matrix
        if self._fresh:
            solver.setup(P=split.P, **given)
            self._fresh = False
        else:
            solver.update(**given)
        if solver.solve() != self._solved:
            return str(solver.result.info.status)
        result = solver.result
        y = result.y if stages else result.z_u - result.z_l
        return *split.joined(result.x, y, result.z_bu - result.z_bl), result.info.iter


if __name__ == "__main__":
    main()
