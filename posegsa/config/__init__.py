"""The typed description of an experiment, and its way to and from TOML.

Every constant of the paper, and every one that it leaves out, is a default here and nowhere else.
`Experiment()` is the recommended experiment.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
