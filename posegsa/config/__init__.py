"""Typed descriptions of experiments, read from and written to TOML.

All constants of the paper, and all that it leaves out, are defaults here and nowhere else.
`Experiment()` is the recommended experiment.
"""

from posegsa.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
