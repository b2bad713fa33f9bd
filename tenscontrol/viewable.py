"""Objects that show themselves in Jupyter and on a web page."""

from __future__ import annotations

from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any


class Viewable:
    """What :func:`tenscontrol.plot.view` takes."""

    def to_html(self, path: str | PathLike[str]) -> Path:
        """Write a web page on which it can be turned and played, and return its path.

        The page is one file and needs no network.

        Parameters
        ----------
        path : str or path
            Where to write; ends in ``.html``. A file that is there is replaced.

        Raises
        ------
        TypeError, ValueError
            If ``path`` is no path, or does not end in ``.html``.
        ImportError
            If plotly is not installed: ``pip install 'tenscontrol[view]'``.
        OSError
            If the file cannot be written: a file that was there is as it was.
        """
        page: Path = self._seen().save(path)
        return page

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, Any]:
        """Return what Jupyter shows: data alone, since its own plotly.js draws it."""
        return {"text/plain": repr(self), "application/vnd.plotly.v1+json": self._seen().figure()}

    def _seen(self) -> Any:
        # By name and when it is asked for: figures know what they draw, which knows no figures.
        return import_module("tenscontrol.plot").view(self)
