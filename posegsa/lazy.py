"""Packages whose names are imported when they are first asked for.

What such a package has stands in its `__init__.pyi`, as the imports that it would begin with: for
type checkers and editors as it is, and for Python by the functions of module `__getattr__` and
`__dir__` (PEP 562). The pattern is Scientific Python's SPEC 1.
"""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def attached(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package.

    Args:
        package: Its `__name__`.
        file: Its `__file__`; beside it is `__init__.pyi`, with lines `from module import x as x`.
    """
    homes = _homes(Path(file).with_name("__init__.pyi"))

    def get(name: str) -> Any:
        module, original = homes.get(name, (package, name))
        if module != package:
            value = getattr(import_module(module), original)
            setattr(sys.modules[package], name, value)  # found without this from now on
            return value
        if find_spec(f"{package}.{original}") is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(f"{package}.{original}")

    return get, lambda: sorted(homes), list(homes)


def _homes(stub: Path) -> dict[str, tuple[str, str]]:
    """The module of each name that a stub imports, and what it is called there."""
    return {
        alias.asname or alias.name: (node.module or "", alias.name)
        for node in ast.parse(stub.read_text("utf-8")).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
