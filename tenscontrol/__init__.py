"""Control-oriented modelling of tensegrity structures.

Each name is imported when it is first used, so that ``import tenscontrol``
loads neither scipy, control, osqp nor matplotlib. ``__init__.pyi`` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
