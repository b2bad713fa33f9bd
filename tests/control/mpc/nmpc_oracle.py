"""The problem of an NMPC solved to convergence by IPOPT: an independent oracle."""

from functools import cached_property

import casadi as ca
import numpy as np

from tenscontrol.control import Command, Controller
from tests.control.mpc.test_linear import kkt_residual


class IpoptNMPC(Controller):
    """Multiple shooting with the prediction model, weights and bounds of an ``NMPC``.

    Started from its last solution and its multipliers, moved on by a sample; but for the first
    sample the barrier starts small, since the bounds that matter hardly change from one sample to
    the next. Where winches wind, the input before matters to the motion, and is weighed at the end.
    Second derivatives are exact, or those of BFGS: the former take long to write where steps are
    implicit.
    """

    def __init__(self, nmpc, tolerance=1e-8, hessian="exact"):
        super().__init__(nmpc.plant, nmpc.sample_time, *nmpc.bounds)
        self._nmpc, N = nmpc, nmpc.horizon
        s, a = nmpc.plant.B.shape
        Q, R, P = nmpc.weights
        # In units that make the problem of order one.
        self._unit = np.r_[np.full(s // 2, 0.1), np.ones(s - s // 2)]
        self._level = nmpc.plant.equilibrium_input.max()
        Z, U = ca.MX.sym("Z", s, N), ca.MX.sym("U", a, N)
        start, r, held = ca.MX.sym("start", s), ca.MX.sym("r", s, N), ca.MX.sym("held", a, N)
        standing = ca.MX.sym("standing", a)
        z, u = ca.mtimes(ca.diag(self._unit), Z), self._level * U
        winds = nmpc.sampled.n_in() == 3
        acting = [ca.horzcat(standing, u[:, :-1]), u] if winds else [u]
        before = ca.horzcat(start, z[:, :-1])
        gaps = (z - nmpc.sampled.map(N)(before, *acting)) / self._unit
        off, effort = z - r, u - held
        cost = ca.sum2(ca.sum1(effort * ca.mtimes(R, effort)))
        cost += ca.sum2(ca.sum1(off[:, :-1] * ca.mtimes(Q, off[:, :-1])))
        last = ca.vertcat(off[:, -1], effort[:, -1]) if winds else off[:, -1]
        cost += ca.mtimes([last.T, P, last])
        problem = {
            "x": ca.vertcat(ca.vec(Z), ca.vec(U)),
            "f": cost,
            "g": ca.vec(gaps),
            "p": ca.vertcat(start, standing, ca.vec(r), ca.vec(held)),
        }
        quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
        options = {
            **quiet, "ipopt.tol": tolerance, "ipopt.warm_start_init_point": "yes",
            "ipopt.hessian_approximation": hessian, "ipopt.max_iter": 3000,
        }  # fmt: skip
        if hessian == "exact" and not winds:
            options["hess_lag"] = self._hessian(problem, cost, nmpc.sampled, Z, U)
        self._given = problem, options
        self._cold = ca.nlpsol("nmpc", "ipopt", problem, options)
        low, high = (np.tile(bound / self._level, N) for bound in self.bounds)
        free = np.full(s * N, np.inf)
        self._bounds = {"lbx": np.r_[-free, low], "ubx": np.r_[free, high], "lbg": 0, "ubg": 0}
        self._split, self._N = s * N, N
        self.reset()

    def _hessian(self, problem, cost, sampled, Z, U):
        """Return the second derivatives of the Lagrangian, those of the motion by samples."""
        (s, N), a = Z.shape, U.shape[0]
        z, u, weight = (ca.SX.sym(name, size) for name, size in zip("zuw", (s, a, s), strict=True))
        gap = -sampled(self._unit * z, self._level * u) / self._unit
        second = ca.hessian(ca.dot(weight, gap), ca.vertcat(z, u))[0]
        of_f, of_g = ca.MX.sym("of_f"), ca.MX.sym("of_g", s, N)
        before = ca.horzcat(problem["p"][:s] / self._unit, Z[:, :-1])
        of_sample = ca.Function("second", [z, u, weight], [second]).map(N)(before, U, of_g)
        # The sample k is of the state before, which is the unknown k − 1, and of the input k.
        first, *others = ca.horzsplit(of_sample, s + a)
        by_states = ca.diagcat(*(each[:s, :s] for each in others), ca.MX(s, s))
        by_both = ca.blockcat([
            [ca.MX(s * (N - 1), a), ca.diagcat(*(each[:s, s:] for each in others))],
            [ca.MX(s, a), ca.MX(s, a * (N - 1))],
        ])  # fmt: skip
        by_inputs = ca.diagcat(*(each[s:, s:] for each in (first, *others)))
        of_motion = ca.blockcat([[by_states, by_both], [ca.MX(a * N, s * N), by_inputs]])
        found = ca.triu(of_f * ca.hessian(cost, problem["x"])[0] + of_motion)
        given = [problem["x"], problem["p"], of_f, ca.vec(of_g)]
        return ca.Function("nlp_hess_l", given, [found])

    @cached_property
    def _warm(self):
        problem, options = self._given
        pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac",
                  "mult_bound_push")  # fmt: skip
        warm = {f"ipopt.warm_start_{name}": 1e-8 for name in pushes} | {"ipopt.mu_init": 1e-6}
        return ca.nlpsol("nmpc", "ipopt", problem, options | warm)

    def reset(self):
        self._x, self._multipliers = None, {}

    def _decide(self, time, state):
        reference, held = self._nmpc.targets(time)
        if self._x is None:
            first = np.tile(state / self._unit, self._N)
            self._x = np.r_[first, (held / self._level).ravel()]
        standing = held[0] if self._previous_input is None else self._previous_input
        parameters = np.r_[state, standing, reference.ravel(), held.ravel()]
        solver = self._warm if self._multipliers else self._cold
        answer = solver(x0=self._x, p=parameters, **self._multipliers, **self._bounds)
        assert solver.stats()["success"], solver.stats()["return_status"]
        x, of_x, of_gaps = (np.array(answer[name]).ravel() for name in ("x", "lam_x", "lam_g"))
        self._multipliers = {"lam_x0": self._moved_on(of_x), "lam_g0": self._moved_on(of_gaps)}
        self.cost = float(answer["f"])
        self.inputs = self._level * x[self._split :].reshape(self._N, -1)
        self._x = self._moved_on(x)
        return Command(self.inputs[0])

    def _moved_on(self, values):
        """Return what belongs to states, and to inputs where there are any, a sample later."""
        parts = (part.reshape(self._N, -1) for part in np.split(values, [self._split]))
        return np.concatenate([np.r_[part[1:], part[-1:]].ravel() for part in parts])

    def _fall_back(self, reason):
        raise AssertionError(reason)


def closed_loop_cost(nmpc, controller, sample, state, count):
    """Return the cost of a closed loop on the prediction model itself, and its states."""
    Q, R, _ = nmpc.weights
    plant, total, states = nmpc.plant, 0.0, [state]
    controller.reset()
    r = plant.degrees_of_freedom
    for k in range(count):
        nodes = plant.to_nodes(state[:r])
        command = controller.command(
            k * nmpc.sample_time, nodes, plant.to_velocities(state[:r], state[r:])
        )
        assert command.status == "ok"
        reference, held = nmpc.targets(k * nmpc.sample_time)
        state = np.array(sample(state, command.value)).ravel()
        off, effort = state - reference[0], command.value - held[0]
        total += off @ Q @ off + effort @ R @ effort
        states.append(state)
    return total, np.array(states)


def optimality(nmpc, nodes, velocities):
    """Return how far the program of a command is from its conditions, and its multipliers."""
    program, kept = nmpc._plan.program.solver, {}
    solve = program.solve

    def watched(q, l, u, start=None, deadline=np.inf):  # noqa: E741
        kept["data"], kept["answer"] = (q, l, u), solve(q, l, u, start, deadline)
        return kept["answer"]

    program.solve = watched
    assert nmpc.command(0.0, nodes, velocities).status == "ok"
    answer, (q, *limits) = kept["answer"], kept["data"]
    far = 1e9  # for infinity, which times zero is nothing
    bounds = (np.clip(limit, -far, far) for limit in limits)
    form = nmpc._plan.program.form
    found = kkt_residual(form.P, q, form.A, *bounds, answer.x, answer.y)
    return found, answer.y
