"""Fuzzy controllers in the formats of other fuzzy tools: written, and two of them read.

format | whose                                     | file       | read back
------ | ----------------------------------------- | ---------- | ---------
`fis`  | MATLAB's Fuzzy Logic Toolbox              | `fis.py`   | yes
`fll`  | fuzzylite, its own                        | `fll.py`   | yes
`fcl`  | IEC 61131-7, Fuzzy Control Language       | `fcl.py`   | no
`fml`  | IEEE 1855, Fuzzy Markup Language          | `fml.py`   | no

`system.py` is what all of them say; what one of them can't say stands in a comment of the file and
in docs/export-formats.md.
"""

from posegsa.exchange.loading import load_controller

__all__ = ["load_controller"]
