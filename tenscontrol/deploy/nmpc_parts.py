"""Nonlinear MPC as parts of C code.

The motion over a sample, the limited rows and their derivatives are CasADi functions. Where their
values go in the matrix of the program, the program itself says.
"""

from __future__ import annotations

import numpy as np

from tenscontrol.control import NMPC
from tenscontrol.control.mpc.nonlinear import CONVERGED
from tenscontrol.control.mpc.osqp_adapter import START_RHO
from tenscontrol.control.mpc.problem import MPCProblem
from tenscontrol.control.mpc.real_time_iteration import NEWTON_STEPS
from tenscontrol.control.mpc.shooting import RK4, StageJacobians
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.deploy.over_time import over_time
from tenscontrol.deploy.parts import Parts, osqp_program, refuse_time_limit
from tenscontrol.validation import FloatArray, IntArray


def nmpc_parts(controller: NMPC) -> Parts:
    """Return the parts of a nonlinear MPC.

    Raises
    ------
    ValueError
        If it predicts by implicit steps, has a time limit, or its reference lasts too long for a
        table.
    """
    law = controller.law
    refuse_time_limit(law.settings.longest_time)
    problem, model = law.problem, law.model
    if not isinstance(model.discretization, RK4):
        raise ValueError(
            "controller is an NMPC that predicts stiff strings or winches that wind, by implicit "
            "steps, which are not written as C code: give a shorter step and winches that jump, "
            "or take MPC, whose prediction is linear"
        )
    N, (s, a) = problem.length, problem.input_matrix.shape
    p = 0 if problem.rows is None else len(problem.rows.scale)
    # Of its own: the program of the controller may be in the middle of a run.
    program = law.subproblem()
    fixed = program.A.data.copy()
    still = _flat(N, s, s, a), None if p == 0 else _flat(N, p, s, a, s)
    program.linearize(*still)
    nothing = np.zeros(s), law.stage_data(np.zeros((N, s)), np.zeros((N, a)))

    def row(time: float) -> FloatArray:
        reference, origin = law.targets(time)
        q, _, _ = program.vectors(nothing[0], law.stage_data(reference, origin), np.zeros(a))
        return np.concatenate([q, reference.ravel(), origin.ravel()])

    first, table = over_time(law.path.span, law.settings.sample_time, N, row)
    low, high = program.vectors(*nothing, np.zeros(a))[1:]
    slopes = np.zeros((len(low), a))
    # Rows of a change are bounded on both sides, and move alike; no others move.
    bounded = np.isfinite(low)
    for i, unit in enumerate(np.eye(a)):
        slopes[bounded, i] = program.vectors(*nothing, unit)[1][bounded] - low[bounded]
    source, factor = _places(program, fixed, (N, s, a, p))
    limit_of_row, limit_scale = _limits(program, problem)
    x, y = program.shifted(np.arange(1.0, program.A.shape[1] + 1), np.arange(1.0, len(low) + 1))
    functions = {
        "advance": model.discretization.sampled,
        "linearize": model.discretization.linearized,
    }
    if model.limited is not None:
        functions["limited"] = model.limited
    matrices = {"by_previous": slopes, "feedback": -problem.feedback}
    loads = 0
    if law.load is not None:
        loads = len(law.load.gain)
        functions["accelerate"] = model.acceleration
        matrices |= {
            "load_gain": law.load.gain,
            "load_push": law.load.response,
            "load_shift": law.load.shift,
            "load_effort": law.load.effort,
        } | _gradients(program, problem)
    return Parts(
        templates=("program.c", "over_time.c", "nmpc.c"),
        constants={
            "UNKNOWNS": program.A.shape[1],
            "ROWS": program.A.shape[0],
            "ENTRIES": len(fixed),
            "HORIZON": N,
            "PLANNED": problem.input_count,
            "LIMITED": p,
            "LOADS": loads,
            "NEWTON_STEPS": NEWTON_STEPS,
            "LEVEL": float(problem.level),
            "ROUNDS": law.rounds,
            "CONVERGED": CONVERGED,
            "FIRST_RHO": START_RHO,
        },
        arrays={
            "unit": program.units,
            "first_low": low,
            "first_high": high,
            "source_of_entry": source,
            "entry": factor,
            "limit_of_row": limit_of_row,
            "limit_scale": limit_scale,
            "source_of_x": x.astype(np.int64) - 1,
            "source_of_y": y.astype(np.int64) - 1,
        },
        matrices=matrices,
        program=osqp_program(law.solver(law.subproblem())),
        table=(first, table),
        functions=functions,
    )


def _flat(N: int, values: int, *arguments: int) -> StageJacobians:
    """Return the stage Jacobians of functions that are zero."""
    return StageJacobians(np.zeros((N, values)), tuple(np.zeros((N, j, values)) for j in arguments))


def _places(
    program: Sparse, fixed: FloatArray, sizes: tuple[int, int, int, int]
) -> tuple[IntArray, FloatArray]:
    """Return which slope each entry of the matrix is, −1 for none, and its factor or its value.

    Slopes are numbered as the C code has them: all A_k, then all B_k, E_k, G_k and F_k, by columns.
    """
    N, s, a, p = sizes
    starts = np.cumsum([0, N * s * s, N * s * a, N * p * s, N * p * a])
    source, factor = np.full(len(fixed), -1), fixed.copy()
    motion, parts = program.motion_indices, program.row_indices
    for begin, slots in [
        *zip(starts[:2], motion, strict=True),
        *((begin, slots) for part in parts for begin, slots in zip(starts[2:], part, strict=True)),
    ]:
        source[slots.index], factor[slots.index] = begin + slots.source, slots.factor
    return source, factor


def _gradients(program: Sparse, problem: MPCProblem) -> dict[str, FloatArray]:
    """Return what references and origins of a sample do to q: that is −P times them, in units."""
    N, (s, a) = problem.length, problem.input_matrix.shape
    starts = {"by_reference": 0, "by_last": (N - 1) * s, "by_origin": N * s}
    found = {}
    for name, start in starts.items():
        unit = np.full(a, problem.level) if name == "by_origin" else program.units
        found[name] = -program.P[start:, start:][: len(unit), : len(unit)].toarray() / unit
    return found


def _limits(program: Sparse, problem: MPCProblem) -> tuple[IntArray, FloatArray]:
    """Return which of the N p limited values each row bounds, −1 for none, and its unit."""
    count, N, rows = program.A.shape[0], problem.length, problem.rows
    limit, unit = np.full(count, -1), np.ones(count)
    for places, start in program.limits.parts:
        assert rows is not None  # there are parts
        found = N * len(program.units) + start + np.arange(N * len(places))
        limit[found] = (len(rows.scale) * np.arange(N)[:, None] + places).ravel()
        unit[found] = np.tile(rows.scale[places], N)
    return limit, unit
