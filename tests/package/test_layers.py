"""The import rule: a folder imports only from those before it in the data flow."""

import ast
from pathlib import Path

import pytest

import posegsa

pytestmark = pytest.mark.quick

LAYERS = (
    "errors arguments words defaults version compiled_programs runtime steps progress settings"
    " | optimisers model | filters | exchange config | recordings | search | judging | figures"
    " | report export | saving"
    " | configuring stream_inputs | tuning evaluating replaying comparing sweeping streaming"
    " | __init__ | cli | __main__"
)
"""Folders and modules of the package. Those between two bars do not import each other, but may
import those before them in the first group."""
PACKAGE = Path(posegsa.__file__).parent


def room(path: Path) -> str:
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def imported(path: Path) -> set[str]:
    """The dotted names that a file imports, also inside functions and only for types.

    The lazy imports of a package are in the stub next to it.
    """
    stub = path.with_suffix(".pyi")
    found = imported(stub) if path.suffix == ".py" and stub.exists() else set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{_module_of(node, path)}.{alias.name}" for alias in node.names}
    return found


def _module_of(node: ast.ImportFrom, path: Path) -> str:
    """The module of an import; relative ones are allowed only in stubs, for `lazy_loader`."""
    if node.level == 0:
        return str(node.module)
    assert path.suffix == ".pyi", f"{path}: relative imports hide where they lead"
    return ".".join(filter(None, (module_name(path), node.module)))


def rooms_of(names: set[str]) -> set[str]:
    """The folders and modules of posegsa in dotted names."""
    known = {name for group in LAYERS.split("|") for name in group.split()}
    parts = [name.split(".") for name in names if name.split(".")[0] == "posegsa"]
    return {p[1] if len(p) > 1 and p[1] in known else "__init__" for p in parts}


def backward_arrows(arrows: dict[str, set[str]]) -> list[str]:
    groups = [group.split() for group in LAYERS.split("|")]
    rank = {name: i for i, group in enumerate(groups) for name in group}
    first = set(groups[0])
    return [
        f"{name} imports {other}"
        for name, others in arrows.items()
        for other in others - {name}
        if rank[other] > rank[name] or (rank[other] == rank[name] and other not in first)
    ]


def circles(arrows: dict[str, set[str]]) -> list[str]:
    """Modules that import themselves through others."""

    def reach(start: str) -> set[str]:
        seen, todo = set(), [*arrows[start]]
        while todo:
            if (name := todo.pop()) not in seen:
                seen.add(name)
                todo += arrows.get(name, ())
        return seen

    return [name for name in arrows if name in reach(name)]


def module_name(path: Path) -> str:
    parts = ("posegsa", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def module_arrows() -> dict[str, set[str]]:
    """The modules that each module imports; the package's public stub does not count."""
    arrows = {}
    for name, path in FILES.items():
        names = imported(path)
        targets = {n if n in FILES else n.rpartition(".")[0] for n in names}
        arrows[name] = {t for t in targets & set(FILES) if not name.startswith(f"{t}.")}
    return arrows


def test_no_arrow_runs_back():
    arrows: dict[str, set[str]] = {}
    for path in FILES.values():
        arrows.setdefault(room(path), set()).update(rooms_of(imported(path)))
    assert backward_arrows(arrows) == []


def test_no_circles():
    assert circles(module_arrows()) == []


def test_the_model_loads_neither_pydantic_nor_matplotlib_nor_an_optimiser():
    foreign = (
        "pydantic",
        "posegsa.settings",
        "matplotlib",
        "optax",
        "posegsa.optimisers",
        "posegsa.config",
    )
    for path in (PACKAGE / "model").glob("*.py"):
        assert not [name for name in imported(path) if name.startswith(foreign)], path


def test_no_public_name_shadows_a_module():
    """`posegsa.x` is the same object whatever was imported before."""
    for name in FILES:
        package, _, own = name.rpartition(".")
        if package and own not in ("__main__",):
            held = getattr(__import__(package, fromlist=["_"]), own, None)
            assert held is None or getattr(held, "__name__", "") == name, name
