"""Trajectories of plant runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.integrate.integrator import IntegrationError
from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.contacts import ContactRecord, record_contacts
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.dense_motion import DenseMotion, States
from tenscontrol.simulation.health import ERROR_LIMIT, HealthLimits
from tenscontrol.simulation.motion_functions import MotionFunctions, read_only
from tenscontrol.simulation.plant_run import PlantRun
from tenscontrol.simulation.strut_record import recorded_struts
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.bar_clearance import BarMotion


def assembled(
    run: PlantRun,
    control: ControlRecord | None,
    errors: FloatArray | None,
    stopped: str | None,
    limits: HealthLimits,
    *,
    given: Arguments,
    note: str | None,
    scene: Any,
    done: tuple[FloatArray, FloatArray] | None,
) -> Trajectory:
    """Return the motion so far; the model evaluates its energies and momenta at all times.

    Bars that cross are looked for if there is a limit on it. ``given`` and ``note`` are what the
    trajectory says of its arguments, ``scene`` what it is a motion of, ``errors`` those of
    :func:`estimated_errors`, ``done`` what drives of bars did.
    """
    model, structure, forces = run.model, run.model.structure, run.equation.forces
    assert forces is not None  # a model has some
    time = np.concatenate([span.time for span in run.spans])
    released = np.zeros(len(time))
    if run.faults.cuts:
        counts = [len(span.time) for span in run.spans]
        released = np.repeat([span.released for span in run.spans], counts)
    nodes, velocities = run.all_motion()
    inputs = run.all_values(run.string_rows)
    load = _load(run)
    functions = MotionFunctions(model, run.supports is not None, inputs, load, core=run.core)
    free, known = not len(structure.fixed_rows), dict[str, Any]()
    contacts = None
    if model.contacts is not None:
        contacts, known = _contacts(run, functions, nodes, velocities, time)
        functions = replace(functions, stored=contacts.stored_energy.sum(axis=0))
    struts = None
    if done is not None:
        off = None if errors is None else errors[1:]
        struts = recorded_struts(run, done, off, functions, (nodes, velocities))
    trajectory = Trajectory(
        structure=structure,
        time=read_only(time),
        nodes=nodes,
        velocities=velocities,
        rest_length=inputs if run.input == "rest_length" else None,
        choice=run.final_choice,
        work=run.work,
        conserves_energy=control is None and not run.moves and forces.conserves_energy,
        conserves_momentum=free
        and forces.conserves_momentum
        and (load is None or (load is not run.load and not load.any())),
        control=control,
        stopped=stopped,
        error=None if errors is None else frozen(errors[0]),
        error_limit=limits.position_error or ERROR_LIMIT,
        released_energy=read_only(released),
        falls=free and contacts is None and model.is_pulled_down,
        contacts=contacts,
        struts=struts,
        faults=run.faults.listed,
        note=note,
        given=given,
        scene=scene,
        _ground=model.ground,
        _functions=functions,
    )
    evaluated = vars(trajectory)
    evaluated |= known
    if limits.crossings is not None:
        bars = _bars(run, time, nodes, velocities)
        crossings, unresolved = bars.searched
        evaluated["_bars"], evaluated["unresolved_intervals"] = bars, unresolved
        evaluated["bar_crossings"] = crossings if bars.has_pairs else None
    return trajectory


def _load(run: PlantRun) -> FloatArray | None:
    """Return what acts on the nodes, (d, n), or (d n, T) where it may change; None for nothing."""
    if run.supports is not None:  # without the inertia that is a load beside the displacement
        inertia = run.supports.force(run.all_values(run.offset_rows, 2))
        return np.asarray(run.all_values(run.load_rows) + inertia)
    if isinstance(run.load, Pieces):
        return run.all_values(run.load_rows)
    if run.load is run.model.constant_force:  # as a rule
        return run.load if run.model.is_loaded else None
    return run.load if run.load.any() else None


def _contacts(
    run: PlantRun,
    functions: MotionFunctions,
    nodes: FloatArray,
    velocities: FloatArray,
    time: FloatArray,
) -> tuple[ContactRecord, dict[str, Any]]:
    """Return the record of the contacts, and what of the trajectory was evaluated for it."""
    known: dict[str, Any] = {}
    kinetic = functions.kinetic_energy(nodes, velocities)
    known["kinetic_energy"] = kinetic
    largest = float(kinetic.max())
    contacts = record_contacts(DenseMotion.of_run(run), nodes, velocities, largest)
    if not len(run.model.structure.fixed_rows) and not isinstance(run.load, Pieces):
        momenta = functions.of("momentum", nodes, velocities)
        known["_momenta"], linear = momenta, momenta[0]
        acting = np.outer(run.load.sum(axis=1), time - time[0])
        off = linear - linear[:, :1] - (contacts.impulse.sum(axis=1) + acting)
        contacts = replace(contacts, impulse_error=float(np.abs(off).max()))
    return contacts, known


def _bars(run: PlantRun, time: FloatArray, nodes: FloatArray, velocities: FloatArray) -> BarMotion:
    """Return the motion of the bars: between outputs, or between ends of steps if those are more.

    Parts of it are integrated again where these are too far apart.
    """
    dense = DenseMotion.of_steps(run)
    if dense is not None:
        time, nodes, velocities = dense.take(slice(1, None)).followed()

    def again(first: int, last: int, parts: int) -> States | None:
        nonlocal dense
        if dense is None:  # as a rule it is not asked for
            dense = DenseMotion.of_run(run)
        if dense.of[first + 1] != dense.of[last + 1]:  # the first part is the start alone
            return None
        try:
            return dense.again(first + 1, last + 1, parts)[0].followed()
        except (IntegrationError, KeyboardInterrupt):
            return None

    return BarMotion(run.model.structure, time, nodes, velocities, again, run.work.steps)
