"""Control-oriented modelling of tensegrity structures.

Each name is imported when it is first used, so that ``import tenscontrol``
loads neither scipy, control, osqp nor matplotlib. ``__init__.pyi`` lists them.
"""

from os.path import dirname, isdir, join

import lazy_loader

_imported, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Return a public name, imported when it is first used."""
    if name in _names:
        return _imported(name)
    from difflib import get_close_matches

    # Programs ask each object for names such as __wrapped__, and a search takes a millisecond.
    near = [] if name.startswith("_") else get_close_matches(name, _names, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise AttributeError(f"tenscontrol has no name {name}{hint}", name=name)


# Without the folders: a star import must not load matplotlib.
__all__ = [name for name in _names if not isdir(join(dirname(__file__), name))]
