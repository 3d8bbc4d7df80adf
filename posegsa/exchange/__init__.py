"""Fuzzy controllers written and read in the formats of other fuzzy tools.

`fis.py` is for MATLAB's Fuzzy Logic Toolbox, `fll.py` for fuzzylite. `system.py` is the common
description of a controller. A comment in each written file, and docs/export-formats.md, say what
its format can't express.
"""

from posegsa.exchange.loading import load_controller

__all__ = ["load_controller"]
