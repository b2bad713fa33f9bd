"""Direct collocation of a motion at Gauss points, as a sparse program for IPOPT."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.evaluator import BUILDING, Function, builds, on_one_thread
from tenscontrol.dynamics.kernel import sparse
from tenscontrol.interrupt import check
from tenscontrol.status import Status

# An interval is not shorter or longer than that of the guess by these factors. With more room
# above, IPOPT runs away to long durations, from which it finds no way back.
_SHORTEST, _LONGEST = 0.02, 4.0

#: Gauss points of an interval. Three take IPOPT longer than twice as many intervals, and it fails
#: more often.
STAGES = 2

#: Label of the rows that are the equation of motion.
EQUATION = "equation of motion"

#: Label of the rows that limit power, which depends on the rate of the input.
POWER = "max_power"

# No time limit, so that iterations are the same in each run. Nearly optimal is not accepted.
_IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-8,
    "mu_strategy": "adaptive",
    "bound_relax_factor": 0.0,
    "acceptable_iter": 0,
    "mumps_pivot_order": 0,
}

# What IPOPT says, and what it is called here.
_STATUSES = {
    "Solve_Succeeded": Status.OK,
    "Solved_To_Acceptable_Level": Status.INACCURATE,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Restoration_Failed": Status.INFEASIBLE,
    "Diverging_Iterates": Status.UNBOUNDED,
    "Maximum_Iterations_Exceeded": Status.OUT_OF_ITERATIONS,
    "User_Requested_Stop": Status.INTERRUPTED,
    "Invalid_Number_Detected": Status.BAD_DATA,
}


@dataclass(frozen=True, eq=False)
class Rows:
    """Expressions that are kept between bounds, scaled to order one.

    Attributes
    ----------
    value : casadi.SX, shape (p, 1)
    low, high : ndarray, shape (p,)
    labels : tuple of str, length p
        What each row keeps, for messages.
    """

    value: Any
    low: FloatArray
    high: FloatArray
    labels: tuple[str, ...]

    def labelled(self, label: str) -> Rows:
        """Return the rows of a label."""
        chosen = [i for i, other in enumerate(self.labels) if other == label]
        return Rows(self.value[chosen], self.low[chosen], self.high[chosen], (label,) * len(chosen))


@dataclass(frozen=True, eq=False)
class Instant:
    """Expressions of an instant of a motion.

    Attributes
    ----------
    places, velocities : casadi.SX, shape (f, 1)
        Free coordinates of the nodes, m, and their rates, m/s.
    input, rate : casadi.SX, shape (m, 1)
        Of the strings, and its rate, of the interval in which the instant is.
    force : casadi.SX, shape (m, 1), or None
        Of motors with inertia, N, where rest lengths are the input: what the motors wind in with.
    """

    places: Any
    velocities: Any
    input: Any
    rate: Any
    force: Any = None


@dataclass(frozen=True, eq=False)
class MotionProgram:
    """A motion to be found, in SI units, before it is discretized.

    Attributes
    ----------
    acceleration : casadi.Function
        ``(places, velocities, input) -> f̈``, smooth.
    limits : callable
        ``Instant -> Rows`` that hold all the time.
    cost_rate : callable
        ``Instant -> cost per second``, one expression.
    tie_rate : callable
        As ``cost_rate``: what is least beside the cost, and no part of it. It decides between
        motions that cost the same.
    end : callable
        ``(places, velocities) -> Rows`` of the end.
    start : ndarray, shape (f,)
        Places at the start, at rest.
    input_range : ndarray, shape (2, m)
        Least and largest input.
    rate_limit : ndarray, shape (m,)
        Largest rate of an input, either way; may be infinite.
    ends : ndarray, shape (2, m), or None
        Inputs at the start and at the end, if they go on from interval to interval; None if they
        may jump between two.
    duration : float or None
        s; None if it is to be found.
    power : callable or None
        ``Instant -> power`` of the motors, W, shape (m, 1): where it is positive, it is a cost too.
    size, time, unit, watt, price : float
        Scales: of places, m, of the duration, s, of inputs, of powers, W, and of the cost.
    """

    acceleration: ca.Function
    limits: Callable[[Instant], Rows]
    cost_rate: Callable[[Instant], Any]
    tie_rate: Callable[[Instant], Any]
    end: Callable[[Any, Any], Rows]
    start: FloatArray
    input_range: FloatArray
    rate_limit: FloatArray
    ends: FloatArray | None
    duration: float | None
    power: Callable[[Instant], Any] | None
    size: float
    time: float
    unit: float
    watt: float
    price: float


@dataclass(frozen=True, eq=False)
class DiscreteMotion:
    """A motion at the ends of its intervals and at its Gauss points.

    Attributes
    ----------
    duration : float
        s.
    places, velocities : ndarray, shape (f, K + 1)
        At the ends of the K intervals.
    begin, end : ndarray, shape (m, K)
        Inputs at the beginning and at the end of each interval, linear between.
    stage_places, stage_velocities : ndarray, shape (f, s, K)
    rates : ndarray, shape (m, K + 1), or None
        Of the inputs at the ends of the intervals, if those are cubic between.
    """

    duration: float
    places: FloatArray
    velocities: FloatArray
    begin: FloatArray
    end: FloatArray
    stage_places: FloatArray
    stage_velocities: FloatArray
    rates: FloatArray | None = None

    def at(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places and velocities at shares of the duration, shape (f, T) each."""
        count = self.begin.shape[1]
        k = np.clip((shares * count).astype(int), 0, count - 1)
        basis = _lagrange(gauss_points(self.stage_places.shape[1]), shares * count - k)
        interpolated = []
        for nodes, stages in (
            (self.places, self.stage_places), (self.velocities, self.stage_velocities)
        ):  # fmt: skip
            whole = np.concatenate([nodes[:, None, :-1], stages], axis=1)
            interpolated.append(np.einsum("fst,st->ft", whole[:, :, k], basis))
        return interpolated[0], interpolated[1]

    def inputs_at(self, shares: FloatArray) -> FloatArray:
        """Return inputs at shares of the duration, shape (m, T)."""
        count = self.begin.shape[1]
        k = np.clip((shares * count).astype(int), 0, count - 1)
        share = shares * count - k
        return np.asarray((1 - share) * self.begin[:, k] + share * self.end[:, k])


def gauss_points(stages: int) -> FloatArray:
    """Return 0 and the Gauss points of the unit interval."""
    return np.append(0.0, (np.polynomial.legendre.leggauss(stages)[0] + 1) / 2)


def _lagrange(points: FloatArray, at: FloatArray, order: int = 0) -> FloatArray:
    """Return the Lagrange polynomials through points, or their derivatives, shape (points, T)."""
    rows = []
    for i, point in enumerate(points):
        others = np.delete(points, i)
        polynomial = np.poly1d(others, r=True) / np.prod(point - others)
        rows.append(np.polyval(polynomial.deriv(order) if order else polynomial, at))
    return np.array(rows)


class _Watch(ca.Callback):  # type: ignore[misc]  # CasADi has no types
    """Counts iterations of IPOPT, and stops it where Ctrl-C has come."""

    def __init__(self, shape: tuple[int, int]) -> None:
        ca.Callback.__init__(self)
        self._shape = shape
        self.iterations, self.interrupted = 0, False
        self.construct("watch", {})

    def get_n_in(self) -> int:
        """Return the number of inputs: those of a solution."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        """Return the shape of an input."""
        unknowns, rows = self._shape
        sizes = {"f": 1, "x": unknowns, "lam_x": unknowns, "g": rows, "lam_g": rows}
        return ca.Sparsity.dense(sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, _: Any) -> list[int]:
        """Return whether to stop."""
        self.iterations += 1
        try:
            check()
        except KeyboardInterrupt:
            self.interrupted = True
        return [int(self.interrupted)]


class Collocation:
    """A motion in intervals of equal length, each a polynomial that obeys the equation of motion.

    Gauss points keep what is quadratic in places and velocities: the lengths of bars and all
    momenta. So the unknowns are places of nodes, without constraints of bars. Those of an interval
    are a block, so that Jacobian and Hessian are those of one block, mapped.
    """

    @builds
    def __init__(self, program: MotionProgram, intervals: int) -> None:
        self.program, self.intervals, self.stages = program, intervals, STAGES
        f, m = len(program.start), program.input_range.shape[1]
        speed, step = program.size / program.time, program.time / intervals
        unknowns = {
            "places": (f, program.size),
            "velocities": (f, speed),
            "begin": (m, program.unit),
            "end": (m, program.unit),
            "paid": (0 if program.power is None else m * STAGES, program.watt),
            "step": (1, step),
            "stage_places": (f * STAGES, program.size),
            "stage_velocities": (f * STAGES, speed),
        }
        self._scales = {name: scale for name, (_, scale) in unknowns.items()}
        edges = np.cumsum([0] + [size for size, _ in unknowns.values()])
        self._places = {
            name: np.arange(first, last)
            for name, first, last in zip(unknowns, edges[:-1], edges[1:], strict=True)
        }
        self._width = int(edges[-1])
        self._size = intervals * self._width + 2 * f
        block = ca.SX.sym("block", self._width)
        real = {n: block[p.tolist()] * self._scales[n] for n, p in self._places.items()}
        self._rows, cost, tie = self._interval(real)
        self._cost = Function(Function("cost", [block], [ca.densify(cost)]).map(intervals))
        last = ca.SX.sym("last", 2 * f)
        self._end = program.end(program.size * last[:f], speed * last[f:])
        self._links = self._link_matrix()
        self._parts = (
            _Derivatives(block, self._rows.value, (cost + tie) / program.price, intervals),
            _Derivatives(last, self._end.value, ca.SX(0), 1),
        )

    # ---- the program ----

    def _interval(self, w: dict[str, Any]) -> tuple[Rows, Any, Any]:
        """Return the rows of an interval, its cost and tie, from its unknowns in SI units."""
        program, step, points = self.program, w["step"], gauss_points(self.stages)
        f, s, m = len(program.start), self.stages, w["begin"].numel()
        N, V = (ca.reshape(w[f"stage_{name}"], f, s) for name in ("places", "velocities"))
        whole = [ca.horzcat(w["places"], N), ca.horzcat(w["velocities"], V)]
        moved, gained = (ca.mtimes(x, ca.DM(_lagrange(points, points[1:], 1))) for x in whole)
        change = w["end"] - w["begin"]
        rate, speed = change / step, self._scales["velocities"]
        weights = np.polynomial.legendre.leggauss(s)[1] / 2
        rows, cost, tie = [], ca.SX(0), ca.SX(0)
        for i in range(s):
            now = Instant(N[:, i], V[:, i], w["begin"] + points[i + 1] * change, rate)
            force = program.acceleration(now.places, now.velocities, now.input)
            rows.append(zero((moved[:, i] - step * now.velocities) / program.size, EQUATION))
            rows.append(zero((gained[:, i] - step * force) / speed, EQUATION))
            rows.append(program.limits(now))
            cost += step * weights[i] * program.cost_rate(now)
            tie += step * weights[i] * program.tie_rate(now)
            if program.power is not None:
                paid = w["paid"][i * m : (i + 1) * m]
                rows.append(positive((paid - program.power(now)) / program.watt, "energy"))
                cost += step * weights[i] * ca.sum1(paid)
        last, speeds = (ca.mtimes(x, ca.DM(_lagrange(points, np.ones(1)))) for x in whole)
        at_end = program.limits(Instant(last, speeds, w["end"], rate))
        if program.ends is not None:  # the next interval begins there, but at another rate
            at_end = at_end.labelled(POWER)
        rows.append(at_end)
        limited = np.flatnonzero(np.isfinite(program.rate_limit)).tolist()
        reach = step * ca.DM(program.rate_limit[limited])
        for sign in (-1, 1):
            rows.append(positive((reach + sign * ca.vec(change[limited])) / program.unit, "rate"))
        rows.append(program.limits(Instant(w["places"], w["velocities"], w["begin"], rate)))
        return stacked(rows), cost, tie

    def _link_matrix(self) -> Any:
        """Return the matrix L of what blocks have in common, L x = 0, sparse, by SciPy."""
        from scipy.sparse import coo_array, csr_array, vstack

        K, width, places = self.intervals, self._width, self._places
        f, last = len(self.program.start), _lagrange(gauss_points(self.stages), np.ones(1)).ravel()
        motion = np.concatenate([places["places"], places["velocities"]])
        equations = []
        for k in range(K):
            after = (k + 1) * width
            nodes = after + motion if k + 1 < K else after + np.arange(2 * f)
            own = [places["places"], *np.split(places["stage_places"], self.stages)]
            fast = [places["velocities"], *np.split(places["stage_velocities"], self.stages)]
            columns = [nodes] + [
                k * width + np.concatenate(pair) for pair in zip(own, fast, strict=True)
            ]
            equations.append((columns, [1.0, *-last]))
            if k + 1 == K:
                break
            names = ["step"] if self.program.ends is None else ["step", "end"]
            for name in names:
                following = places["begin" if name == "end" else name]
                equations.append(([after + following, k * width + places[name]], [1.0, -1.0]))
        blocks = []
        for columns, factors in equations:
            count = len(columns[0])
            entries = np.concatenate([np.full(count, factor) for factor in factors])
            rows = np.tile(np.arange(count), len(columns))
            index = (rows, np.concatenate(columns))
            blocks.append(csr_array(coo_array((entries, index), shape=(count, self._size))))
        return vstack(blocks, format="csr")

    def _program(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the program in CasADi, and its derivatives."""
        K, width, links = self.intervals, self._width, self._links.tocoo()
        x = ca.MX.sym("x", self._size)
        given = [ca.reshape(x[: K * width], width, K), x[K * width :]]
        values = [
            functions.value(block) for functions, block in zip(self._parts, given, strict=True)
        ]
        cost = ca.sum2(values[0][1])
        L = sparse(links)
        g = ca.vertcat(*(ca.vec(value[0]) for value in values), ca.mtimes(L, x))
        slope = ca.vertcat(ca.vec(self._parts[0].slope(given[0])), ca.DM.zeros(given[1].numel()))
        entries = [
            functions.jacobian(block) for functions, block in zip(self._parts, given, strict=True)
        ]
        jacobian = self._jacobian([ca.vec(nonzeros) for nonzeros in entries], links)
        p, sigma, lam = ca.MX.sym("p", 0), ca.MX.sym("sigma"), ca.MX.sym("lam", g.numel())
        ends = np.cumsum([0, *(value[0].numel() for value in values)])
        second = [
            functions.second(block, ca.reshape(lam[a:b], *value[0].shape), sigma)
            for functions, block, value, a, b in zip(
                self._parts, given, values, ends[:-1], ends[1:], strict=True
            )
        ]
        patterns = [self._parts[0].pattern] * K + [self._parts[1].pattern]
        hessian = ca.MX(ca.diagcat(*patterns), ca.vertcat(*map(ca.vec, second)))
        names = ["x", "p"]
        derivatives = {
            "grad_f": Function("grad_f", [x, p], [cost, slope], names, ["f", "grad_f_x"]),
            "jac_g": Function("jac_g", [x, p], [g, jacobian], names, ["g", "jac_g_x"]),
            "hess_lag": Function(
                "hess_lag", [x, p, sigma, lam], [hessian], [*names, "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        }  # fmt: skip
        return {"x": x, "p": p, "f": cost, "g": g}, derivatives

    def _jacobian(self, entries: list[Any], links: Any) -> Any:
        """Return the Jacobian from the entries of those of the blocks and of the end."""
        from scipy.sparse import coo_array

        K, width = self.intervals, self._width
        rows, columns = list[IntArray](), list[IntArray]()
        top = 0
        for functions, count, left in zip(self._parts, (K, 1), (0, K * width), strict=True):
            row, column = functions.entries
            height = functions.height
            rows += [top + k * height + row for k in range(count)]
            columns += [left + k * width + column for k in range(count)]
            top += count * height
        row = np.concatenate([*rows, top + links.row])
        column = np.concatenate([*columns, links.col])
        numbered = coo_array(
            (np.arange(1, len(row) + 1), (row, column)), shape=(top + links.shape[0], self._size)
        ).tocsc()
        numbered.sort_indices()
        values = ca.vertcat(*entries, ca.DM(links.data))
        return ca.MX(_pattern(numbered), values[(numbered.data - 1).tolist()])

    # ---- its solution ----

    @on_one_thread
    def solve(self, guess: DiscreteMotion, most_iterations: int) -> Solution:
        """Return the optimum that IPOPT finds from a guess, or where it ended.

        Raises ValueError if there are fewer unknowns than equations.
        """
        x0 = self._packed(guess)
        low, high = self._bounds(guess.duration)
        row_low, row_high = self._row_bounds()
        unknowns, equations = int((low < high).sum()), int((row_low == row_high).sum())
        if unknowns < equations:
            raise ValueError(
                f"intervals is {self.intervals}, which leaves a motion {unknowns} unknowns for "
                f"{equations} equations: give more intervals"
            )
        with BUILDING:
            problem, derivatives = self._program()
            watch = _Watch((self._size, len(row_low)))
            options = {
                "print_time": False,
                "show_eval_warnings": False,
                "error_on_fail": False,
                "iteration_callback": watch,
                "ipopt": {**_IPOPT, "max_iter": most_iterations},
                **derivatives,
            }
            solver = ca.nlpsol("motion", "ipopt", problem, options)
            answer = solver(x0=x0, lbx=low, ubx=high, lbg=row_low, ubg=row_high)
            message = str(solver.stats()["return_status"])
        if watch.interrupted:
            raise KeyboardInterrupt
        names = ("x", "g", "lam_x", "lam_g")
        x, rows, *multipliers = (np.array(answer[name].full()).ravel() for name in names)
        return Solution(
            motion=self._unpacked(x),
            violations=self._violations(np.maximum(row_low - rows, rows - row_high)),
            cost=float(ca.sum2(self._cost(self._blocks(x)))),
            status=_STATUSES.get(message, Status.UNSOLVED),
            message=message.replace("_", " ").lower(),
            iterations=watch.iterations,
            multipliers=(multipliers[0], multipliers[1]),
        )

    def _violations(self, outside: FloatArray) -> dict[str, float]:
        """Return by how much rows of each label are outside their bounds, the largest first."""
        links = (EQUATION,) * self._links.shape[0]
        labels = np.array([*self._rows.labels * self.intervals, *self._end.labels, *links])
        worst = {str(label): float(outside[labels == label].max()) for label in np.unique(labels)}
        return dict(sorted(worst.items(), key=lambda item: -item[1]))

    def _packed(self, guess: DiscreteMotion) -> FloatArray:
        """Return the unknowns of a motion, which may have other intervals."""
        K, points = self.intervals, gauss_points(self.stages)
        shares = ((np.arange(K)[:, None] + points) / K).ravel()
        nodes, speeds = (x.reshape(-1, K, len(points)) for x in guess.at(shares))
        last = [array[:, -1] for array in (guess.places, guess.velocities)]
        begin = guess.inputs_at(np.arange(K) / K + 1e-9 / K)
        end = guess.inputs_at(np.arange(1, K + 1) / K - 1e-9 / K)
        values = {
            "places": nodes[:, :, 0],
            "velocities": speeds[:, :, 0],
            "begin": begin,
            "end": end,
            "paid": np.zeros((len(self._places["paid"]), K)),
            "step": np.full((1, K), guess.duration / K),
            "stage_places": nodes[:, :, 1:].transpose(2, 0, 1).reshape(-1, K),
            "stage_velocities": speeds[:, :, 1:].transpose(2, 0, 1).reshape(-1, K),
        }
        x = np.empty((self._width, K))
        for name, places in self._places.items():
            x[places] = values[name] / self._scales[name]
        ends = [
            final / self._scales[name]
            for final, name in zip(last, ("places", "velocities"), strict=True)
        ]
        return np.concatenate([x.ravel(order="F"), *ends])

    def _blocks(self, x: FloatArray) -> FloatArray:
        """Return the unknowns of each interval, a column each."""
        return x[: self.intervals * self._width].reshape(self.intervals, self._width).T

    def _unpacked(self, x: FloatArray) -> DiscreteMotion:
        K, width, f = self.intervals, self._width, len(self.program.start)
        blocks = self._blocks(x)
        value = {n: blocks[p] * self._scales[n] for n, p in self._places.items()}
        last = x[K * width :].reshape(2, f)
        for name, end in zip(("places", "velocities"), last, strict=True):
            value[name] = np.column_stack([value[name], end * self._scales[name]])
        stages = [
            value[f"stage_{name}"].reshape(self.stages, f, K).swapaxes(0, 1)
            for name in ("places", "velocities")
        ]
        low, high = self.program.input_range[:, :, None]
        begin, end = (np.clip(value[name], low, high) for name in ("begin", "end"))
        return DiscreteMotion(
            float(value["step"].sum()), value["places"], value["velocities"], begin, end, *stages
        )

    def _bounds(self, duration: float) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the unknowns."""
        program, K, places = self.program, self.intervals, self._places
        low, high = np.full((self._width, K), -np.inf), np.full((self._width, K), np.inf)
        names = ("begin", "end") if program.ends is None else ("begin",)
        for name in names:
            low[places[name]] = program.input_range[0][:, None]
            high[places[name]] = program.input_range[1][:, None]
        low[places["paid"]] = 0.0
        step = places["step"], 0  # the others are linked to it
        if program.duration is None:
            low[step], high[step] = duration / K * np.array([_SHORTEST, _LONGEST])
        else:
            low[step] = high[step] = program.duration / K
        for bound in (low, high):
            bound[places["places"], 0] = program.start
            bound[places["velocities"], 0] = 0.0
            if program.ends is not None:
                bound[places["begin"], 0], bound[places["end"], -1] = program.ends
            for name, own in places.items():
                bound[own] /= self._scales[name]
        last = np.full(2 * len(program.start), np.inf)
        return (
            np.concatenate([low.ravel(order="F"), -last]),
            np.concatenate([high.ravel(order="F"), last]),
        )

    def _row_bounds(self) -> tuple[FloatArray, FloatArray]:
        given = ["places", "velocities", *(["begin"] if self.program.ends is not None else [])]
        row, column = self._parts[0].entries
        is_given = np.isin(column, np.concatenate([self._places[name] for name in given]))
        open_rows = np.isin(np.arange(self._parts[0].height), row[~is_given])
        bounds = []
        for own, end, away in (
            (self._rows.low, self._end.low, -np.inf),
            (self._rows.high, self._end.high, np.inf),
        ):
            every = np.tile(own[:, None], self.intervals)
            every[~open_rows, 0] = away  # of the start alone, which is given
            bounds.append(
                np.concatenate([every.ravel(order="F"), end, np.zeros(self._links.shape[0])])
            )
        return bounds[0], bounds[1]


@dataclass(frozen=True, eq=False)
class Solution:
    """Where IPOPT ended.

    ``violations`` are those of rows by their labels, scaled to order one; ``multipliers`` are those
    of the bounds of the unknowns, and of the rows.
    """

    motion: DiscreteMotion
    violations: dict[str, float]
    cost: float
    status: Status
    message: str
    iterations: int
    multipliers: tuple[FloatArray, FloatArray]


class _Derivatives:
    """Rows and a cost of the unknowns of a block, and their derivatives, of many blocks at once."""

    def __init__(self, block: Any, rows: Any, cost: Any, count: int) -> None:
        rows = ca.densify(rows)
        self.height = rows.numel()
        lam, sigma = ca.SX.sym("lam", self.height), ca.SX.sym("sigma")
        jacobian, slope = ca.jacobian(rows, block), ca.densify(ca.gradient(cost, block))
        lagrangian = sigma * cost + ca.dot(lam, rows)
        hessian = ca.triu(ca.hessian(lagrangian, block)[0])
        self.pattern = hessian.sparsity()
        self.entries = tuple(
            np.array(indices, dtype=int) for indices in jacobian.sparsity().get_triplet()
        )

        def mapped(name: str, given: list[Any], results: list[Any]) -> ca.Function:
            return Function(Function(name, given, ca.cse(results)).map(count))

        self.value = mapped("value", [block], [rows, ca.densify(cost)])
        self.slope = mapped("slope", [block], [slope])
        self.jacobian = mapped("jacobian", [block], [_entries(jacobian)])
        self._second = mapped("second", [block, lam, sigma], [_entries(hessian)])
        self._count = count

    def second(self, blocks: Any, multipliers: Any, sigma: Any) -> Any:
        """Return the entries of the upper triangles of the Hessians, one block a column."""
        return self._second(blocks, multipliers, ca.repmat(sigma, 1, self._count))


def _entries(matrix: Any) -> Any:
    """Return what a sparse matrix has as a dense column."""
    return ca.densify(matrix.nz[:]) if matrix.nnz() else ca.SX(0, 1)


def _pattern(matrix: Any) -> Any:
    """Return the pattern of a matrix of SciPy in CasADi."""
    matrix = matrix.tocsc()
    return ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())


def zero(value: Any, label: str) -> Rows:
    """Return rows that are zero."""
    bound = np.zeros(value.numel())
    return Rows(value, bound, bound, (label,) * value.numel())


def positive(value: Any, label: str, least: float = 0.0) -> Rows:
    """Return rows that are at least a number."""
    count = value.numel()
    return Rows(value, np.full(count, least), np.full(count, np.inf), (label,) * count)


def stacked(rows: list[Rows]) -> Rows:
    """Return rows one below the other."""
    return Rows(
        ca.vertcat(ca.SX(0, 1), *(row.value for row in rows)),
        np.concatenate([np.zeros(0), *(row.low for row in rows)]),
        np.concatenate([np.zeros(0), *(row.high for row in rows)]),
        sum((row.labels for row in rows), ()),
    )
