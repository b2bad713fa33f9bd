"""A rectangular net of strings with fixed nodes."""

from __future__ import annotations

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure


def net(
    rows: int, columns: int, spacing: float, node_mass: float, fixed: object = "corners"
) -> Structure:
    """Return a flat rectangular net of strings with point masses at its knots.

    Node ``columns · i + j`` is knot j of row i, at (j, i, 0) times ``spacing``. The strings along
    the rows come first, group ``"row"``, then those along the columns, group ``"column"``.

    Parameters
    ----------
    rows : int
        Number of rows of knots, at least 2.
    columns : int
        Number of knots in a row, at least 2.
    spacing : float
        Distance between neighbouring knots, m.
    node_mass : float
        Mass of each free knot, kg.
    fixed : {"corners", "edges"} or sequence of int or None
        The knots held in place: the four corners, all knots on the edges, or
        those with these indices. None holds nothing: strings pull the net together.

    Returns
    -------
    Structure
        With ``rows · columns`` nodes, no bars, and
        ``rows (columns − 1) + columns (rows − 1)`` strings.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or every knot is fixed.

    Notes
    -----
    A class-0 structure, for which M_s is the point masses alone (Goyal & Skelton, *Dynamics of
    Class 1 Tensegrity Systems Including Cable Mass*, conclusions).

    Examples
    --------
    >>> import tenscontrol as tc
    >>> net = tc.net(rows=3, columns=4, spacing=0.1, node_mass=0.01)
    >>> net, net.fixed
    (Structure(12 nodes, 0 bars, 17 strings), array([ 0,  3,  8, 11]))
    """
    count_rows = validation.whole_number("rows", rows, least=2)
    count_columns = validation.whole_number("columns", columns, least=2)
    asked = f"rows is {count_rows} and columns is {count_columns}"
    refuse_many_members(asked, 2 * count_rows * count_columns)
    step = validation.positive_number("spacing", spacing, "m")
    mass = validation.positive_number("node_mass", node_mass, "kg")
    knots = np.arange(count_rows * count_columns).reshape(count_rows, count_columns)
    held = _held(fixed, knots)
    if np.isin(knots, held).all():
        raise ValueError(
            f"fixed holds all {knots.size} knots of the net, so that nothing can move; "
            "hold fewer, or give more rows and columns"
        )
    i, j = np.divmod(knots.ravel(), count_columns)
    along_rows = np.column_stack([knots[:, :-1].ravel(), knots[:, 1:].ravel()])
    along_columns = np.column_stack([knots[:-1].ravel(), knots[1:].ravel()])
    return Structure(
        nodes=step * np.vstack([j, i, np.zeros(knots.size)]),
        bars=[],
        strings=np.vstack([along_rows, along_columns]),
        bar_mass=[],
        string_node_mass=mass,
        string_groups=("row",) * len(along_rows) + ("column",) * len(along_columns),
        fixed=held,
    )


def _held(fixed: object, knots: IntArray) -> IntArray | FloatArray:
    """Return the indices of the fixed knots; Structure checks those given as numbers."""
    if fixed is None:
        return np.zeros(0, dtype=np.int64)
    if not isinstance(fixed, str):
        return validation.index_array("fixed", fixed, knots.size)
    if validation.choice("fixed", fixed, ("corners", "edges")) == "corners":
        return knots[[0, 0, -1, -1], [0, -1, 0, -1]]
    inner = knots[1:-1, 1:-1]
    return np.setdiff1d(knots, inner)
