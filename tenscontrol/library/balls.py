"""Balls: single bars in a closed net of strings, with the symmetry of a regular solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.library.sizes import of_sizes
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import rotation_about

_GOLDEN = (1 + np.sqrt(5)) / 2


@of_sizes
def six_bar_ball(bar_length: float = 1.7, bar_mass: ArrayLike = 1.0) -> Structure:
    """Return the six-bar ball, or expandable octahedron: three pairs of parallel bars.

    The bars of a pair are half a bar length apart, the only distance at which strings of one length
    balance. Nodes 2 i and 2 i + 1 are the ends of bar i. The default is the size of NASA's
    SUPERball, whose bars are 1.7 m long.

    One state of self-stress, one mechanism.

    Parameters
    ----------
    bar_length : float
        Length of each bar, m.
    bar_mass : float or array_like, shape (6,)
        Mass of each bar, kg.

    Returns
    -------
    Structure
        With 24 strings of √(3/8) bar lengths.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite.

    Notes
    -----
    Nodes are the cyclic permutations of (0, ± l/2, ± l/4), strings all pairs of nodes of different
    directions that are nearest to each other. Under the force density γ of all strings the bars
    have 3/2 γ. Pugh, *An Introduction to Tensegrity* (1976). The size is that of J. Bruce, A. P.
    Sabelhaus et al., *SUPERball: Exploring Tensegrities for Planetary Probes* (2014).

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ball = tc.library.six_bar_ball(bar_length=1.0)
    >>> ball, ball.string_length()[:2].round(4)
    (Structure(12 nodes, 6 bars, 24 strings), array([0.6124, 0.6124]))
    """
    length = validation.positive_number("bar_length", bar_length, "m")
    nodes = np.zeros((12, 3))
    for axis in range(3):  # the bars of a pair are along this one and apart along the next
        rows = 4 * axis + np.arange(4)
        nodes[rows, axis] = [-length / 2, length / 2, -length / 2, length / 2]
        nodes[rows, (axis + 1) % 3] = [-length / 4, -length / 4, length / 4, length / 4]
    bars = np.arange(12).reshape(6, 2)
    distance = np.linalg.norm(nodes[:, None] - nodes, axis=2)
    near = np.abs(distance - np.sqrt(3 / 8) * length) < 1e-6 * length
    return Structure(
        nodes=nodes.T, bars=bars, strings=np.argwhere(np.triu(near)), bar_mass=bar_mass
    )


@of_sizes
def truncated_tetrahedron(bar_length: float = 1.0, bar_mass: ArrayLike = 1.0) -> Structure:
    """Return the truncated tetrahedron: six bars in four triangles, which six strings join.

    The strings are in the groups ``"face"``, twelve, and ``"edge"``, six.

    One state of self-stress, seven mechanisms, which prestress stiffens.

    Parameters
    ----------
    bar_length : float
        Length of each bar, m.
    bar_mass : float or array_like, shape (6,)
        Mass of each bar, kg.

    Returns
    -------
    Structure

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite.

    Notes
    -----
    The super-stable shape in which all strings have one force density, with the rotations of a
    tetrahedron: R. Connelly and A. Back, *Mathematics and Tensegrity* (1998). Murakami and
    Nishimura, *Static and dynamic characterization of regular truncated icosahedral and
    dodecahedral tensegrity modules* (2001), have its family.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.truncated_tetrahedron().string_length().round(4)[[0, -1]]
    array([0.3712, 0.5468])
    """
    face = _turn([1, 1, 1], 2 * np.pi / 3)
    return _ball(face, _half_turn([0, 0, 1]), _half_turn([0, 1, 0]), bar_length, bar_mass)


@of_sizes
def twelve_bar_ball(bar_length: float = 1.0, bar_mass: ArrayLike = 1.0) -> Structure:
    """Return the twelve-bar ball: a net like a truncated octahedron, six squares joined by strings.

    The strings are in the groups ``"face"``, 24, and ``"edge"``, twelve.

    One state of self-stress, 19 mechanisms, which prestress stiffens.

    Parameters
    ----------
    bar_length : float
        Length of each bar, m.
    bar_mass : float or array_like, shape (12,)
        Mass of each bar, kg.

    Returns
    -------
    Structure

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite.

    Notes
    -----
    The super-stable shape in which all strings have one force density, with the rotations of a
    cube: R. Connelly and A. Back, *Mathematics and Tensegrity* (1998).

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.library.twelve_bar_ball()
    Structure(24 nodes, 12 bars, 36 strings)
    """
    face, edge = _turn([0, 0, 1], np.pi / 2), _half_turn([1, 0, 1])
    return _ball(face, edge, _half_turn([0, 1, 1]), bar_length, bar_mass)


@of_sizes
def thirty_bar_ball(bar_length: float = 1.0, bar_mass: ArrayLike = 1.0) -> Structure:
    """Return the thirty-bar ball: a net like a truncated icosahedron, twelve pentagons joined.

    All strings are equally long; they are in the groups ``"face"``, 60, and ``"edge"``, 30.

    One state of self-stress, 55 mechanisms, which prestress stiffens.

    Parameters
    ----------
    bar_length : float
        Length of each bar, m.
    bar_mass : float or array_like, shape (30,)
        Mass of each bar, kg.

    Returns
    -------
    Structure

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite.

    Notes
    -----
    The super-stable shape in which all strings have one force density, with the rotations of an
    icosahedron: R. Connelly and A. Back, *Mathematics and Tensegrity* (1998).

    Examples
    --------
    >>> import tenscontrol as tc
    >>> ball = tc.library.thirty_bar_ball()
    >>> ball, ball.string_length()[[0, -1]].round(4)
    (Structure(60 nodes, 30 bars, 90 strings), array([0.3568, 0.3568]))
    """
    face = _turn([0, 1, _GOLDEN], 2 * np.pi / 5)
    edge, bar = _half_turn([1, _GOLDEN**2, _GOLDEN]), _half_turn([_GOLDEN, 1, _GOLDEN**2])
    return _ball(face, edge, bar, bar_length, bar_mass)


def _turn(axis: list[float], angle: float) -> FloatArray:
    """Return the rotation by an angle about an axis."""
    return rotation_about(np.array(axis) / np.linalg.norm(axis), angle)


def _half_turn(axis: list[float]) -> FloatArray:
    return _turn(axis, np.pi)


def _ball(
    face: FloatArray, edge: FloatArray, bar: FloatArray, bar_length: float, bar_mass: ArrayLike
) -> Structure:
    """Return the ball of all places R p of one node p, with R of the group of two rotations.

    From R p there are strings to R face p, R face⁻¹ p and R edge p, and a bar to R bar p. With one
    force density of strings, and w that of bars, p balances if A p = w D p.
    """
    from scipy.linalg import eigh

    length = validation.positive_number("bar_length", bar_length, "m")
    group = _group(face, edge)
    pull, push = 3 * np.eye(3) - face - face.T - edge, np.eye(3) - bar
    # The bars with the least force: they leave the stress matrix without a negative eigenvalue.
    _, vectors = eigh(push, pull)
    nodes = group @ vectors[:, -1]
    pairs = {
        name: _joined(group, step) for name, step in {"face": face, "edge": edge, "": bar}.items()
    }
    bars = pairs.pop("")
    start, end = bars[0]
    nodes *= length / np.linalg.norm(nodes[start] - nodes[end])
    return Structure(
        nodes=nodes.T,
        bars=bars,
        strings=np.vstack(list(pairs.values())),
        bar_mass=bar_mass,
        string_groups=[name for name, members in pairs.items() for _ in members],
    )


def _group(*generators: FloatArray) -> FloatArray:
    """Return all products of rotations, shape (·, 3, 3)."""
    group = [np.eye(3)]
    for rotation in group:  # grows as it goes
        for step in generators:
            product = rotation @ step
            if np.abs(np.array(group) - product).max(axis=(1, 2)).min() > 1e-6:
                group.append(product)
    return np.array(group)


def _joined(group: FloatArray, step: FloatArray) -> np.ndarray:
    """Return the pairs of nodes R p and R step p, each once, shape (·, 2)."""
    off = np.abs((group @ step)[:, None] - group).max(axis=(2, 3))
    pairs = np.column_stack([np.arange(len(group)), off.argmin(axis=1)])
    return np.unique(np.sort(pairs), axis=0)
