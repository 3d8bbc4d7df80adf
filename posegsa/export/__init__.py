"""A tuned filter, or its schedule, out of Python, in one of `FORMATS`."""

from posegsa.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
