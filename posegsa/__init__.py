"""A nonlinear pose filter on SE(3) with a fuzzy gain schedule, tuned by gravitational search.

Data flow: config -> scenarios (truth + measurements) -> filter step + fuzzy gain -> rollout -> cost
-> population (agents x scenarios) -> optimiser -> result -> held-out evaluation -> figures.

Importing it changes nothing in the process. `enable_fast_path()`, called first, makes CPUs fast.

Its names stand in `__init__.pyi`, and are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
