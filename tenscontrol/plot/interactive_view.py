"""Views of structures, runs, modes and paths, to be turned in a browser."""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatch

import numpy as np

from tenscontrol import validation
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.modes import Modes
from tenscontrol.plant.string_outputs import to_model_strings
from tenscontrol.plot.ground_drawing import ground_surface
from tenscontrol.plot.structure_drawing import (
    checked_force_density,
    driven_bars,
    known_actuation,
    passive_strings,
)
from tenscontrol.plot.web_page import View
from tenscontrol.shape.shape_path import ShapePath
from tenscontrol.shape.target import ShapeTarget
from tenscontrol.simulation.strength import Strength
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.structure import Structure


def view(
    shown: Structure
    | Prestress
    | ShapeTarget
    | LinearPlant
    | Trajectory
    | Strength
    | Modes
    | ShapePath,
    *,
    force_density: object = None,
) -> View:
    """Return a view of a structure, a plant, a run, modes or a path, to be turned in a browser.

    Nothing is written or opened yet: ``view(run).save("run.html")`` writes the page, one file that
    needs no network, ``view(run).open()`` shows it in the browser, and Jupyter shows what a cell
    ends with. Bars are dark and wide, strings thin and coloured, slack strings dotted, and dashed
    those that no winch of a plant or a controlled run drives. Nodes show their number under the
    mouse.

    Parameters
    ----------
    shown : Structure, Prestress, ShapeTarget, LinearPlant, Trajectory, Strength, Modes or ShapePath
        A run or path is played and scrubbed; of its strength, with strings and bars coloured by
        force over strength. Of modes, one is chosen, with an amplitude. A prestress and a target
        have the colours of their force densities.
    force_density : float or array_like, shape (α,), optional
        γ, N/m, by which the strings of a structure are coloured; a run and a path have their own.

    Returns
    -------
    View

    Raises
    ------
    TypeError, ValueError
        If ``shown`` is nothing that can be viewed, or ``force_density`` does not fit, is negative,
        or is given beside what is no structure.

    Notes
    -----
    The page needs plotly: ``pip install 'tenscontrol[view]'``.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ball = tc.library.six_bar_ball()
    >>> tc.plot.view(ball)
    View('structure: 12 nodes, 6 bars, 24 strings')
    >>> tc.plot.view(tc.prestress(ball, 20.0))
    View('prestress: 12 nodes, 6 bars, 24 strings')
    """
    page = _view_of(shown)
    if force_density is None:
        return page
    if not isinstance(shown, Structure):
        raise ValueError(
            f"force_density is given, but shown is {shown!r}: expected a Structure beside it"
        )
    gamma = checked_force_density(shown, force_density)
    return replace(page, force_density=np.asarray(gamma)[:, None])


@singledispatch
def _view_of(shown: object) -> View:
    raise validation.wrong_kind(
        "shown",
        shown,
        "a Structure, a Trajectory of simulate, a Strength, a Prestress, a ShapeTarget, a plant, "
        "Modes or a ShapePath",
    )


@_view_of.register
def _of_structure(shown: Structure) -> View:
    return View("structure", shown, shown.nodes[:, :, None])


@_view_of.register
def _of_prestress(shown: Prestress) -> View:
    nodes, gamma = shown.nodes[:, :, None], shown.force_density[:, None]
    return View("prestress", shown.structure, nodes, force_density=gamma)


@_view_of.register
def _of_target(shown: ShapeTarget) -> View:
    return replace(_of_prestress(shown.prestress), what="target")


@_view_of.register
def _of_run(shown: Trajectory) -> View:
    points = shown.nodes.reshape(len(shown.nodes), -1)
    surfaces = (ground_surface(law, points) for law in shown.ground)
    pressed = None
    if shown.contacts is not None:
        pressed = np.zeros(shown.nodes.shape[1:], dtype=bool)
        np.logical_or.at(pressed, shown.contacts.node, shown.contacts.normal_force > 0)
    return View(
        f"run of {shown.time[-1]:g} s by {shown.method}",
        shown.structure,
        shown.nodes,
        shown.time,
        shown.force_density,
        ground=tuple(grid for grid in surfaces if grid is not None),
        pressed=pressed,
        passive=passive_strings(shown.structure, known_actuation(shown)),
        struts=driven_bars(shown),
    )


@_view_of.register
def _of_plant(shown: LinearPlant) -> View:
    structure = shown.model.structure
    gamma = to_model_strings(shown, "force_density", shown.force_density)
    return View(
        "plant",
        structure,
        shown.nodes[:, :, None],
        force_density=gamma[:, None],
        passive=passive_strings(structure, known_actuation(shown)),
        struts=driven_bars(shown),
    )


@_view_of.register
def _of_strength(shown: Strength) -> View:
    margins = np.vstack([shown.string_margin, shown.bar_margin])
    return replace(_of_run(shown.run), share=1 / margins)


@_view_of.register
def _of_path(shown: ShapePath) -> View:
    title, structure = f"path of {shown.time[-1]:g} s", shown.model.structure
    return View(
        title, structure, shown.nodes, shown.time, shown.force_density, struts=driven_bars(shown)
    )


@_view_of.register
def _of_modes(shown: Modes) -> View:
    frequencies = [f"{frequency:#.4g}" if frequency > 0 else "0" for frequency in shown.frequency]
    names = [
        f"{i}: {frequency} Hz, {label}"
        for i, (frequency, label) in enumerate(zip(frequencies, shown.label, strict=True))
    ]
    title = f"{len(names)} mode{'s' * (len(names) != 1)}"
    shapes = shown.shape if names else None
    nodes = shown.nodes[:, :, None]
    return View(title, shown.structure, nodes, shapes=shapes, labels=tuple(names))
