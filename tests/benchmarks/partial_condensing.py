"""Programs of NMPC condensed in blocks of stages, against programs stage by stage.

Run: ``python -m tests.benchmarks.partial_condensing``. The prism, the six-bar ball and a tower of
five stages, the last two with winches, horizon 20, 0.02 s samples. Programs of closed loops are
condensed in blocks of stages by the BLAS: an inner state is what the first state of its block and
the inputs make of it. The program that is left goes to the active set along stages, as NMPC uses
it, and with ``--interior`` to PIQP multistage. One block is the fully condensed program.

The active set takes weights that all stages share. It gets blocks with those of their last state
alone, so that blocks of more than one stage take less time than they would. Preparation
(condensing, the Riccati recursion of blocks) and feedback are ratios of processor time to those
stage by stage, in turn. PIQP solves the whole program, and its plan is compared.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix

import tenscontrol as tc
from tenscontrol.control import NMPC, ControlWarning
from tenscontrol.control.mpc import MPCProblem, StageJacobians
from tenscontrol.control.mpc.stages import LeastDistance
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options
from tests.benchmarks.nmpc_large import SAMPLE
from tests.benchmarks.nmpc_large import built as with_winches

HORIZON, STARTS, SAMPLES = 20, 2, 8
BLOCKS = (1, 2, 4, 5, 10, 20)
PUSH, SHAKEN = 1.5, 0.1  # m/s, at the start and in each sample: bounds are met
LIMIT = 33.0  # N/m, little above the prestress of the prism
EXACT = 1e-8  # PIQP's tolerance
HEAD = (
    "  stages in a block   condensing   recursion  preparation     feedback        whole   changes"
)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, starts=STARTS, samples=SAMPLES, horizon=HORIZON, blocks=BLOCKS,
        stages=5, structures=3, interior=False,
    )  # fmt: skip
    structures = {
        "prism": tc.prism(),
        "six-bar ball": tc.library.six_bar_ball(bar_length=1.0),
        f"tower, {given.stages} stages": tc.prism_tower(given.stages),
    }
    for name, structure in list(structures.items())[: given.structures]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a mode that no string reaches
            warnings.simplefilter("ignore", ControlWarning)
            nmpc = controller(structure, given.horizon)
        programs = recorded(nmpc, given.starts, given.samples)
        n, a = nmpc.law.problem.input_matrix.shape
        print(f"{name}: {len(programs)} programs of {n} states and {a} inputs a stage")
        print(HEAD)
        spent = along_stages(nmpc, programs, given.blocks)
        if given.interior:
            interior(nmpc.law, programs, given.blocks, spent)


def controller(structure, horizon):
    """Return an NMPC: of the prism with held force densities, else with winches."""
    if len(structure.bars) > 3:
        return with_winches(structure, horizon, linearization_tolerance=0.0)
    plant = tc.linearize(tc.Model(structure), tc.prestress(structure, demo.TOP_FORCE_DENSITY))
    given = {"sample_time": SAMPLE, "max_force_density": LIMIT}
    return NMPC(plant, horizon=horizon, **given)


@dataclass(frozen=True, eq=False)
class Program:
    """What the program of a sample is prepared and solved with."""

    states: np.ndarray
    inputs: np.ndarray
    motion: StageJacobians
    rows: StageJacobians | None
    measured: tuple


class Recorder(LeastDistance):
    """The active set along stages, which keeps copies of what it is given."""

    def linearize(self, states, inputs, motion, rows):
        copies = (
            None if each is None else StageJacobians(
                each.values.copy(), tuple(part.copy() for part in each.in_order().slopes)
            )
            for each in (motion, rows)
        )  # fmt: skip
        self._kept = states.copy(), inputs.copy(), *copies
        return super().linearize(states, inputs, motion, rows)

    def solve(self, state, data, previous, acting, deadline):
        self.programs.append(Program(*self._kept, (state, data, previous, acting)))
        return super().solve(state, data, previous, acting, deadline)


def recorded(nmpc, starts, count):
    """Return the programs of closed loops that begin with a push, the first of each left out."""
    plant, programs = nmpc.plant, []
    law = nmpc.law
    nmpc._plan.program = Recorder(
        law.problem, law.row_bounds, law.settings.max_iterations, law.bounds
    )
    nmpc._plan.program.programs = programs
    r, last = plant.degrees_of_freedom, []
    for seed in range(starts):
        rng = np.random.default_rng(seed)
        state = plant.measure(plant.nodes, PUSH * rng.normal(size=plant.nodes.shape))
        nmpc.reset()
        for k in range(count):
            measured = plant.to_nodes(state[:r]), plant.to_velocities(state[:r], state[r:])
            command = nmpc.command(k * SAMPLE, *measured)
            if command.status != "ok":
                raise SystemExit(f"a program was not solved: {command}")
            state, _ = nmpc.law.model.discretization.advance(state, command.value, command.value)
            state[r:] += SHAKEN * rng.normal(size=r)
        last += programs[1:]
        programs.clear()
    return last


@dataclass(frozen=True, eq=False)
class Blocks:
    """A program in blocks of stages: matrices by columns, of the first state and the inputs."""

    inner: list[np.ndarray]  # states after 1 … M stages, (blocks, n + M α, n)
    offsets: list[np.ndarray]  # of these states, (blocks, n)
    hessian: np.ndarray  # (blocks, n + M α, n + M α), without the last state of a block
    rows: StageJacobians | None


def condensed(problem: MPCProblem, program: Program, size: int) -> Blocks:
    """Eliminate all states but the first of each block."""
    (n, a), N = problem.input_matrix.shape, problem.length
    count, wide = N // size, n + size * a
    A, B = (part.reshape(count, size, *part.shape[1:]) for part in program.motion.slopes)
    gap = (program.motion.values - program.states[1:]).reshape(count, size, n)
    scale, hessian = problem.cost_scale, np.zeros((count, wide, wide))
    for k in range(size):
        at = slice(n + k * a, n + (k + 1) * a)
        hessian[:, at, at] = scale * problem.input_weight
    state, offset = np.zeros((count, wide, n)), np.zeros((count, n))
    state[:, np.arange(n), np.arange(n)] = 1.0
    inner, offsets, parts, values = [], [], [], []
    Q, rows = scale * problem.state_weight, program.rows
    if rows is not None:
        E, G, F = (part.reshape(count, size, *part.shape[1:]) for part in rows.slopes)
        values = rows.values.reshape(count, size, -1).copy()
    for k in range(size):
        used, at = n + k * a, slice(n + k * a, n + (k + 1) * a)
        if k:
            hessian[:, :used, :used] += (state[:, :used] @ Q) @ state[:, :used].swapaxes(1, 2)
        later = np.zeros_like(state)
        np.matmul(state[:, :used], A[:, k], out=later[:, :used])
        later[:, at] = B[:, k]
        past, offset = offset, (offset[:, None] @ A[:, k])[:, 0] + gap[:, k]
        if rows is not None:
            part = np.zeros((count, wide, E.shape[-1]))
            np.matmul(state[:, :used], E[:, k], out=part[:, :used])
            part[:, at] = G[:, k]
            values[:, k] += (past[:, None] @ E[:, k])[:, 0]
            if F.any():
                part += later @ F[:, k]
                values[:, k] += (offset[:, None] @ F[:, k])[:, 0]
            parts.append(part)
        state = later
        inner.append(state)
        offsets.append(offset)
    limited = None
    if rows is not None:
        whole = np.concatenate(parts, axis=2)
        none = np.zeros((count, n, whole.shape[2]))
        slopes = np.ascontiguousarray(whole[:, :n]), np.ascontiguousarray(whole[:, n:]), none
        limited = StageJacobians(values.reshape(count, -1), slopes)
    return Blocks(inner, offsets, hessian, limited)


def blockwise(nmpc, size):
    """Return an active set along blocks: of their sizes, with the weights of their last states."""
    problem, tile = nmpc.law.problem, lambda part: None if part is None else np.tile(part, size)
    rows = problem.rows
    if rows is not None:
        by_all = ((rows.by_state, (size, 1)), (rows.by_next_state, (size, 1)),
                  (rows.by_input, (size, size)))  # fmt: skip
        rows = replace(
            rows, **dict(zip(("by_state", "by_next_state", "by_input"),
                             (np.tile(*each) for each in by_all), strict=True)),
            scale=tile(rows.scale), penalty=tile(rows.penalty),
        )  # fmt: skip
    larger = replace(
        problem,
        input_matrix=np.tile(problem.input_matrix, size),
        input_weight=np.kron(np.eye(size), problem.input_weight),
        low=tile(problem.low), high=tile(problem.high), change=tile(problem.change),
        length=problem.length // size, feedback=np.tile(problem.feedback, (size, 1)), rows=rows,
    )  # fmt: skip
    bounds = [tuple(map(tile, pair)) for pair in (nmpc.law.row_bounds, nmpc.law.bounds)]
    return LeastDistance(larger, bounds[0], nmpc.law.settings.max_iterations, bounds[1])


def along_stages(nmpc, programs, sizes):
    """Print times by the active set along stages, or along blocks; return that stage by stage."""
    problem = nmpc.law.problem
    n, N = len(problem.drift), problem.length
    solvers = {size: blockwise(nmpc, size) for size in sizes if N % size == 0}
    times = {size: [] for size in solvers}
    for each in programs:
        for size, solver in solvers.items():
            count, (state, data, previous, acting) = N // size, each.measured
            began = process_time()
            motion, rows = each.motion, each.rows
            if size > 1:
                blocks = condensed(problem, each, size)
                last = blocks.inner[-1]
                by_all = (np.ascontiguousarray(part) for part in (last[:, :n], last[:, n:]))
                ends = each.states[size::size] + blocks.offsets[-1]
                motion, rows = StageJacobians(ends, tuple(by_all)), blocks.rows
            ready = process_time()
            inputs = np.vstack([np.tile(acting, size), each.inputs[1:].reshape(count, -1)])
            if not solver.linearize(each.states[::size].copy(), inputs, motion, rows):
                raise SystemExit(f"a program in blocks of {size} was not prepared")
            data = replace(
                data, reference=data.reference[size - 1 :: size], drift=data.drift[::size],
                input_reference=data.input_reference.reshape(count, -1),
            )  # fmt: skip
            prepared = process_time()
            answer = solver.solve(state, data, np.tile(previous, size), inputs[0], np.inf)
            spent = process_time() - prepared
            times[size].append((ready - began, prepared - ready, spent, answer.iterations))
    base = np.median(times[min(times)], axis=0)
    for size, found in times.items():
        condense, prepare, solve, changes = np.median(found, axis=0)
        whole = condense + prepare
        print(
            f"  {size:17d} {condense / base[1]:12.2f} {prepare / base[1]:11.2f} "
            f"{whole / base[1]:12.2f} {solve / base[2]:12.2f} "
            f"{(whole + solve) / base[1:3].sum():12.2f} {changes:9.0f}", flush=True,
        )  # fmt: skip
    return base[1:3].sum()


def interior(law, programs, sizes, spent):
    """Print times by PIQP multistage of the whole program, its limits hard, and plans compared."""
    import piqp

    problem = law.problem
    sizes = [size for size in sizes if problem.length % size == 0]
    solvers = dict.fromkeys(sizes)
    times, apart = {size: [] for size in sizes}, 0.0
    for each in programs:
        plans = {}
        for size in sizes:
            began = process_time()
            blocks = condensed(problem, each, size)
            ready = process_time()
            given = quadratic(law, each, blocks, size)
            prepared = process_time()
            solver = solvers[size]
            if solver is None:
                solver = solvers[size] = piqp.SparseSolver()
                settings = solver.settings
                settings.kkt_solver = piqp.KKTSolver.sparse_multistage
                settings.eps_abs = settings.eps_rel = EXACT
                settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = EXACT
                solver.setup(**given)
            else:
                solver.update(**given)
            solved = solver.solve() == piqp.PIQP_SOLVED
            spent = process_time() - prepared + (ready - began if size > 1 else 0.0)
            if solved:
                plans[size] = planned(problem, np.array(solver.result.x), size)
                times[size].append(spent)
            else:
                times[size].append(np.nan)
        found = list(plans.values())
        apart = max([apart, *(np.abs(plan - found[0]).max() / problem.level for plan in found)])
    print(f"  PIQP, time over stage by stage; plans at most {apart:.0e} of an input apart:")
    base = np.array(times[sizes[0]])
    print(f"    stage by stage over the active set: {np.nanmedian(base) / spent:.1f}")
    ratios = (f"{size}: {np.nanmedian(np.array(times[size]) / base):.2f} "
              f"({np.isnan(times[size]).sum()} not solved)" for size in sizes)  # fmt: skip
    print("    " + ", ".join(ratios), flush=True)


def planned(problem, x, size):
    """Return departures of inputs, (N, α)."""
    (n, a), count = problem.input_matrix.shape, problem.length // size
    return x.reshape(count, size * a + n)[:, : size * a].reshape(-1, a)


def quadratic(law, program, blocks, size):
    """Return the program for PIQP: unknown are U_0, z_1, U_1, …, departures from the plan."""
    problem, row_bounds = law.problem, law.row_bounds
    (n, a), N, scale = problem.input_matrix.shape, problem.length, problem.cost_scale
    count, m = N // size, size * a
    state, data, previous, _ = program.measured
    assert not data.drift.any()
    first, wide = state - program.states[0], m + n
    Q, R = scale * problem.state_weight, scale * problem.input_weight
    off = (program.states[1:] - data.reference).reshape(count, size, n)
    effort = ((program.inputs[1:] - data.input_reference) @ R).reshape(count, m)
    P, A, G = Pieces(), Pieces(), Pieces()
    c, b = np.zeros(count * wide), []
    least, most = np.full(count * wide, -np.inf), np.full(count * wide, np.inf)
    h_l, h_u = [], []
    low, high = (
        np.tile(bound, size) - program.inputs[1:].reshape(count, m) for bound in law.bounds
    )  # fmt: skip
    moves = np.eye(m) - np.eye(m, k=-a)
    steps = np.diff(program.inputs, axis=0)
    steps[0] = program.inputs[1] - previous
    steps = steps.reshape(count, m)
    for k in range(count):
        at, end, before = k * wide, k * wide + m, k * wide - n
        linear = np.zeros(n + m)
        for j in range(size - 1):
            linear += blocks.inner[j][k] @ (Q @ (off[k, j] + blocks.offsets[j][k]))
        linear[n:] += effort[k]
        H, T = blocks.hessian[k], blocks.inner[-1][k]
        last = Q if k < count - 1 else scale * problem.terminal_weight
        P.put(at, at, H[n:, n:])
        P.put(end, end, last)
        c[at:end] += linear[n:]
        c[end : end + n] += last @ off[k, -1]
        right = -blocks.offsets[-1][k]
        A.put(k * n, at, T[n:].T)
        A.put(k * n, end, -np.eye(n))
        if k:
            P.put(before, before, H[:n, :n])
            P.put(before, at, H[:n, n:])
            P.put(at, before, H[n:, :n])
            c[before:at] += linear[:n]
            A.put(k * n, before, T[:n].T)
        else:
            c[at:end] += H[n:, :n] @ first
            right = right - first @ T[:n]
        b.append(right)
        least[at:end], most[at:end] = low[k], high[k]
        if problem.change is not None:
            row = len(h_l) and sum(map(len, h_l))
            G.put(row, at, moves)
            if k:
                G.put(row, before - a, -np.eye(a))
            reach = np.tile(problem.change, size)
            h_l.append(-reach - steps[k])
            h_u.append(reach - steps[k])
        if blocks.rows is not None:
            row = len(h_l) and sum(map(len, h_l))
            by_z, by_u = (part[k] for part in blocks.rows.slopes[:2])
            values = blocks.rows.values[k] + (0.0 if k else first @ by_z)
            G.put(row, at, by_u.T)
            if k:
                G.put(row, before, by_z.T)
            h_l.append(np.tile(row_bounds[0], size) - values)
            h_u.append(np.tile(row_bounds[1], size) - values)
    size_x, rows = count * wide, sum(map(len, h_l))
    return {
        "P": P.matrix(size_x, size_x), "c": c, "A": A.matrix(count * n, size_x),
        "b": np.concatenate(b), "x_l": least, "x_u": most,
        **({"G": G.matrix(rows, size_x), "h_l": np.concatenate(h_l), "h_u": np.concatenate(h_u)}
           if rows else {}),
    }  # fmt: skip


class Pieces:
    """Dense blocks of a sparse matrix; those at the same place add up, and zeros stay."""

    def __init__(self):
        self.parts = []

    def put(self, row, column, block):
        rows, columns = np.indices(block.shape)
        self.parts.append((block.ravel(), (rows + row).ravel(), (columns + column).ravel()))

    def matrix(self, rows, columns):
        data, i, j = (np.concatenate(part) for part in zip(*self.parts, strict=True))
        found = csc_matrix(coo_matrix((data, (i, j)), shape=(rows, columns)))
        found.sort_indices()
        return found


if __name__ == "__main__":
    main()
