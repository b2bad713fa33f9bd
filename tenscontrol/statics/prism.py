"""The prestress of a prism in closed form."""

from __future__ import annotations

import numpy as np

from tenscontrol.validation import FloatArray, positive_number, whole_number


def prism_force_density(
    sides: int,
    force_density: float,
    radius: float = 1.0,
    top_radius: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the force densities at which a prism rests, in the order of :func:`prism`.

    With top radius a and bottom radius b::

        γ_v = λ = 2 sin(π/q) γ_t a/b,    γ_b = γ_t a²/b²

    so that for three bars and equal radii γ_v = √3 γ_t. The height plays no part.

    Parameters
    ----------
    sides : int
        Number q of bars, at least 3.
    force_density : float
        γ_t of the top strings, N/m.
    radius, top_radius : float
        Radii of bottom and top, m; only their ratio matters. Equal if
        ``top_radius`` is not given.

    Returns
    -------
    strings : ndarray, shape (3q,)
        γ of top, bottom and vertical strings, N/m.
    bars : ndarray, shape (q,)
        λ of the bars, N/m, positive in compression.

    Raises
    ------
    TypeError, ValueError
        If a number is not positive and finite or ``sides`` is below 3.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> strings, bars = tc.statics.prism_force_density(3, 10.0)
    >>> strings[[0, 3, 6]].round(4)
    array([10.    , 10.    , 17.3205])
    """
    q = whole_number("sides", sides, least=3)
    top = positive_number("force_density", force_density, "N/m")
    b = positive_number("radius", radius, "m")
    a = b if top_radius is None else positive_number("top_radius", top_radius, "m")
    vertical = 2 * np.sin(np.pi / q) * top * a / b
    bottom = top * (a / b) ** 2
    return np.repeat([top, bottom, vertical], q), np.full(q, vertical)
