"""Fuzzy controllers in the formats of other fuzzy tools, written and read.

`fis.py` is MATLAB's Fuzzy Logic Toolbox, `fll.py` is fuzzylite. `system.py` holds what both formats
express; what a format can't express is written in a comment of the file, and in
docs/export-formats.md.
"""

from posegsa.exchange.loading import load_controller

__all__ = ["load_controller"]
