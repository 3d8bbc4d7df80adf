"""Typed descriptions of experiments, read from and written to TOML.

All constants of the paper, and those that it leaves out, are defaults of an experiment here.
`Experiment()` is that of configs/observer.toml.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
