"""A view to be turned, played and scrubbed in a browser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tenscontrol.plant import Modes
from tenscontrol.plot.structure_drawing import checked_force_density
from tenscontrol.shape import ShapePath
from tenscontrol.simulation import Trajectory
from tenscontrol.structure import Structure
from tenscontrol.validation import wrong_kind
from tenscontrol.web_page import View


def view(
    shown: Structure | Trajectory | Modes | ShapePath, *, force_density: object = None
) -> View:
    """Return a view of a structure, a run, modes or a path, to be turned in a browser.

    Nothing is written or opened yet: ``view(run).save("run.html")`` writes the page, one file that
    needs no network, ``view(run).open()`` shows it in the browser, and Jupyter shows what a cell
    ends with. Bars are dark and wide, strings thin and coloured, slack strings dotted. Nodes show
    their number under the mouse.

    Parameters
    ----------
    shown : Structure, Trajectory, Modes or ShapePath
        A run or path is played and scrubbed. Of modes, one is chosen, with an amplitude.
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
    >>> tc.plot.view(ball, force_density=tc.prestress(ball, 20.0).force_density)
    View('structure: 12 nodes, 6 bars, 24 strings')
    """
    if not isinstance(shown, Structure | Trajectory | Modes | ShapePath):
        raise wrong_kind(
            "shown", shown, "a Structure, a Trajectory of simulate, Modes or a ShapePath"
        )
    found = shown.view()
    if force_density is None:
        return found
    if not isinstance(shown, Structure):
        raise ValueError(
            f"force_density is given, but shown is {shown!r}: expected a Structure beside it"
        )
    gamma = checked_force_density(shown, force_density)
    return replace(found, force_density=np.asarray(gamma)[:, None])
