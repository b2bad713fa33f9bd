"""What this installation consists of."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from tenscontrol._version import __version__
from tenscontrol.core.library import absence

# The libraries that figures come from.
_LIBRARIES = ("numpy", "scipy", "casadi", "control", "osqp", "matplotlib")


def show_config() -> None:
    """Print the versions of this installation, and whether it has the compiled core.

    For reports of faults. ``tenscontrol --version`` says in one line whether the core is there.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.show_config()  # doctest: +ELLIPSIS
    tenscontrol  ...
    """
    rows = {"tenscontrol": __version__, "compiled core": absence() or "yes"}
    rows |= {"Python": platform.python_version(), "machine": platform.platform()}
    rows |= {name: _version(name) for name in _LIBRARIES}
    for name, value in rows.items():
        print(f"{name:<14} {value}")


def core_line() -> str:
    """Return one line that says whether the core is there, and why not."""
    missing = absence()
    return f"no compiled core: {missing}" if missing else "with the compiled core"


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"
