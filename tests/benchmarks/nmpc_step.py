"""NMPC by real-time iterations against converged solutions: closed-loop cost and time of a step.

Run: ``python -m tests.benchmarks.nmpc_step``. The prism (36 states as nodes, 18 reduced), 9
inputs, horizon 20, 0.02 s samples, from disturbed starts; the same prediction model, weights and
bounds for all: NMPC with one program a sample, with derivatives of the core, and of CasADi as with
laws of one's own, compiled or not; NMPC with as many programs as it takes; IPOPT through CasADi's
nlpsol, and, where it is installed, do-mpc (which calls IPOPT as well, with MUMPS as it does by
default). IPOPT and do-mpc start from their last solutions and stop at a tolerance of 1e-6. A step
is preparation and feedback together. All controllers meet the same starts in turn. Numbers are
ratios of one run on one machine; time of the processor is told beside that of the clock, since a
busy machine adds to the latter.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Sequence
from time import perf_counter, process_time

import casadi as ca
import numpy as np

import tenscontrol as tc
from tenscontrol.control import NMPC, Command, Controller, Status
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options
from tests.control.mpc.nmpc_oracle import IpoptNMPC, closed_loop_cost
from tests.without_core import without_core

LIMIT = 33.0  # N/m, little above the prestress, so that bounds are met
STARTS, SAMPLES, HORIZON = 5, 25, 20
SIZE = 0.05  # m, of each coordinate of a node: starts do not depend on the basis of the plant


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, starts=STARTS, samples=SAMPLES, horizon=HORIZON)
    N = given.horizon
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    asked = {"horizon": N, "sample_time": demo.SAMPLE, "max_force_density": LIMIT}
    one = NMPC(plant, **asked)
    with without_core():
        own = {code: NMPC(plant, machine_code=code, **asked) for code in (True, False)}
    loops = {
        "NMPC": one,
        "own law, compiled": own[True],
        "own law": own[False],
        "NMPC, converged": NMPC(plant, iterations=20, **asked),
        "MPC, linear": tc.MPC(plant, horizon=N, sample_time=demo.SAMPLE, max_force_density=LIMIT),
        "IPOPT (nlpsol)": IpoptNMPC(one, tolerance=1e-6),
    }
    peer = "do-mpc (IPOPT)"
    if importlib.util.find_spec("do_mpc") is None:
        print(
            "do-mpc is not installed (extra bench): its row is left out, IPOPT's is compared with"
        )
        peer = "IPOPT (nlpsol)"
    else:
        loops[peer] = DoMpc(one)
    costs: dict[str, list[float]] = {name: [] for name in loops}
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in loops}
    feedback, bounded = [], 0
    for seed in range(given.starts):
        rng = np.random.default_rng(seed)
        N = prism.nodes + SIZE * rng.normal(size=(3, 6))
        state = plant.measure(N, 5 * SIZE * rng.normal(size=(3, 6)))
        for name, controller in loops.items():
            timed = Timed(controller)
            cost, _ = closed_loop_cost(one, timed, one.sampled, state, given.samples)
            costs[name].append(cost)
            times[name] += timed.times
            if controller is one:
                feedback += list(one.statistics.feedback_time)
                bounded += timed.bounded
    best = np.array(costs["IPOPT (nlpsol)"])
    reference = np.median(times[peer], axis=0)
    print(
        f"{given.starts} starts, {given.samples} samples each; "
        f"a bound active in {bounded} commands of NMPC"
    )
    print(f"derivatives of NMPC: {one.back_end}; with own laws, compiled: {own[True].back_end}")
    print(
        "                    closed-loop cost / IPOPT    time of a step: do-mpc / this      p99 /"
    )
    print(
        "                        mean      worst      median  processor     p99    clock  processor"
    )
    for name in loops:
        ratio, spent = np.array(costs[name]) / best, np.array(times[name])
        (median, processor), late = np.median(spent, axis=0), np.percentile(spent, 99, axis=0)
        late_peer = np.percentile(np.array(times[peer])[:, 0], 99)
        print(
            f"{name:20s} {ratio.mean():9.5f}  {ratio.max():9.5f}  {reference[0] / median:10.1f}"
            f" {reference[1] / processor:10.1f} {late_peer / late[0]:7.1f}"
            f" {late[0] / demo.SAMPLE:8.3f} {late[1] / demo.SAMPLE:10.3f}"
        )
    print(f"feedback of NMPC alone: {reference[0] / np.median(feedback):.1f}")


class Timed(Controller):
    """A controller whose commands are timed, the first left out."""

    def __init__(self, controller):
        super().__init__(controller.plant, controller.sample_time, *controller.bounds)
        self._controller = controller
        self.times, self.bounded = [], 0

    def reset(self):
        self._controller.reset()
        self._first = True

    def command(self, time, nodes, velocities):
        began, used = perf_counter(), process_time()
        command = self._controller.command(time, nodes, velocities)
        if not self._first:
            self.times.append((perf_counter() - began, process_time() - used))
        self._first = False
        self.bounded += bool((command.value >= LIMIT - 1e-6).any())
        return command

    def _decide(self, time, state):
        raise NotImplementedError  # command is passed on whole

    def _fall_back(self, reason):
        raise NotImplementedError  # command is passed on whole


class DoMpc(Controller):
    """The same problem given to do-mpc."""

    def __init__(self, nmpc):
        super().__init__(nmpc.plant, nmpc.sample_time, *nmpc.bounds)
        self._held = nmpc.plant.equilibrium_input
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what the peer says of itself
            self._mpc = self._built(nmpc)

    def _built(self, nmpc):
        import do_mpc

        s, a = nmpc.plant.B.shape
        Q, R, P = (ca.DM(weight) for weight in nmpc.weights)
        model = do_mpc.model.Model("discrete", "MX")
        z = model.set_variable("_x", "z", shape=(s, 1))
        u = model.set_variable("_u", "u", shape=(a, 1))
        model.set_rhs("z", nmpc.sampled(z, u))
        model.setup()
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon, mpc.settings.t_step = nmpc.horizon, nmpc.sample_time
        mpc.settings.store_full_solution = False
        mpc.settings.supress_ipopt_output()
        mpc.settings.nlpsol_opts["ipopt.tol"] = 1e-6
        # do-mpc counts z_0, which is given, and the inputs in its stage cost: the same optimum.
        off = u - ca.DM(self._held)
        mpc.set_objective(mterm=ca.bilin(P, z, z), lterm=ca.bilin(Q, z, z) + ca.bilin(R, off, off))
        mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = nmpc.bounds
        mpc.scaling["_u", "u"] = self._held.max()
        mpc.setup()
        return mpc

    def reset(self):
        self._fresh = True
        self._mpc.reset_history()

    def _decide(self, time, state):
        if self._fresh:
            self._mpc.x0, self._mpc.u0 = state, self._held
            self._mpc.set_initial_guess()
            self._fresh = False
        value = self._mpc.make_step(state.reshape(-1, 1)).ravel()
        status = Status.OK if self._mpc.data["success"][-1] else Status.UNSOLVED
        return Command(value, status)

    def _fall_back(self, reason):
        raise AssertionError(reason)


if __name__ == "__main__":
    main()
