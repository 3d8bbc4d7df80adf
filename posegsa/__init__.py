"""A nonlinear pose filter on SE(3) with a fuzzy gain schedule, tuned by gravitational search.

Data flow: config -> scenarios (truth + measurements) -> filter step + fuzzy gain -> rollout -> cost
-> population (agents x scenarios) -> optimiser -> result -> held-out evaluation -> figures.

Importing posegsa changes nothing in the process. Call `enable_fast_path()` first for speed on CPUs.

`__init__.pyi` lists the public names. Each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
