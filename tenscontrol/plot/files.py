"""Figures written to files."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

_DPI = 130


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure to a file, close it, and return where it is.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : Path
        The ending says the format.

    Returns
    -------
    Path

    Examples
    --------
    >>> import tempfile, pathlib, matplotlib
    >>> matplotlib.use("Agg")
    >>> import tenscontrol as tc
    >>> figure = tc.plot.structure(tc.prism()).ax.figure
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tc.plot.save_figure(figure, pathlib.Path(folder) / "prism.png").name
    'prism.png'
    """
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)
    return path
