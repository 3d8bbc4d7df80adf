"""The import rule: a module imports only what stands to its left in the data flow."""

import ast
from pathlib import Path

import posegsa

LAYERS = [
    "errors",
    "arguments",
    "files",
    "run_folder",
    "interrupt",
    "observability",
    "optimisers",
    "checkpoint",
    "history",
    "config",
    "elementwise",
    "memory",
    "named_optimisers",
    "se3",
    "measurements",
    "filter",
    "fuzzy",
    "gain",
    "cost",
    "rollout",
    "scenario",
    "family",
    "trajectory",
    "parameters",
    "population",
    "baselines",
    "metrics",
    "keys",
    "comparison",
    "trust",
    "figure_style",
    "plots",
    "plots_evaluation",
    "significance",
    "compared",
    "plots_compare",
    "report",
    "runtime",
    "results",
    "export",
    "devices",
    "resume",
    "search",
    "compare",
    "batch",
    "tuning",
    "evaluate",
    "__init__",
    "cli_arguments",
    "cli_progress",
    "cli_compare",
    "cli",
    "__main__",
]
PACKAGE = Path(posegsa.__file__).parent


def layer(path: Path) -> str:
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def imported(path: Path) -> set[str]:
    """The layers of posegsa that a file imports, inside functions too, but not for types alone."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in ast.walk(tree):
        if node in for_types:
            continue
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide where they lead"
            module = node.module or ""
            names = [f"{module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == "posegsa":
                found.add(parts[1] if len(parts) > 1 else "__init__")
    return {name if name in LAYERS else "__init__" for name in found}


def backward_arrows(files: dict[str, set[str]]) -> list[str]:
    rank = {name: i for i, name in enumerate(LAYERS)}
    return [
        f"{name} imports {other}"
        for name, others in files.items()
        for other in others
        if other != name and rank[other] > rank[name]
    ]


def test_no_arrow_runs_back():
    files = sorted(PACKAGE.rglob("*.py"))
    modules: dict[str, set[str]] = {}
    for path in files:
        modules.setdefault(layer(path), set()).update(imported(path))
    assert set(modules) == set(LAYERS), "list every module, once, where it stands in the flow"
    assert backward_arrows(modules) == []


def test_the_check_sees_a_backward_arrow():
    assert backward_arrows({"filter": {"tuning", "se3"}}) == ["filter imports tuning"]


def test_optimisers_know_nothing_of_the_filter():
    for path in (PACKAGE / "optimisers").glob("*.py"):
        assert imported(path) <= {"optimisers", "errors"}


def test_no_module_is_too_long_to_take_in():
    long = {
        p.name: n for p in PACKAGE.rglob("*.py") if (n := len(p.read_text().splitlines())) > 400
    }
    assert long == {}
