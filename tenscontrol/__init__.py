"""Control-oriented modelling of tensegrity structures.

Each name is imported when it is first used, so that ``import tenscontrol``
loads neither scipy, control, osqp nor matplotlib. ``__init__.pyi`` lists them.
"""

from os.path import dirname, isdir, join

import lazy_loader

__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
# Without the folders: a star import must not load matplotlib.
__all__ = [name for name in _names if not isdir(join(dirname(__file__), name))]
