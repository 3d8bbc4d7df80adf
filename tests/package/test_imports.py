"""`import posegsa`, help and refused arguments import no heavy packages."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

import posegsa
from posegsa import config, export
from posegsa.export import FORMATS

pytestmark = pytest.mark.quick

HEAVY = {"jax", "jaxlib", "numpy", "scipy", "pydantic", "matplotlib", "optax", "jinja2", "tqdm"}
SHOW = f"""
import atexit, sys
atexit.register(lambda: print("loaded:", *sorted({HEAVY} & set(sys.modules))))
"""


def loaded(code: str, *options: str) -> set[str]:
    """The heavy packages that a fresh interpreter with these options has imported at its end."""
    done = subprocess.run(
        [sys.executable, "-W", "error", *options, "-c", SHOW + code],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


def command(*arguments: str) -> str:
    return f"from posegsa.cli import main; sys.exit(main({list(arguments)}))"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["configs"],
        ["config", "show", "no such"],
        ["no such"],
        *(
            [name, option]
            for name in ("tune", "evaluate", "replay", "export", "sweep")
            for option in ("--help", "--no-such")
        ),
        ["compare", "--no-such"],
        ["tune", "--schedule", "no such"],
        ["export", "run", "--format", "no such"],
        ["replay", "imu", "a.csv", "--frame", "no such"],
        ["tune", "--bridge", "no such"],
    ],
    ids=" ".join,
)
def test_help_lists_and_refused_arguments_need_nothing_heavy(arguments):
    assert loaded(command(*arguments)) == set()


def test_import_posegsa_needs_nothing_heavy():
    assert loaded("import posegsa; dir(posegsa); posegsa.__version__; posegsa.__all__") == set()
    assert "numpy" in loaded("import posegsa; posegsa.box"), "the check sees what is loaded"


def test_nothing_is_loaded_to_draw_before_something_is_drawn():
    assert "matplotlib" not in loaded("from posegsa import *")
    drawn = """
import numpy as np
from posegsa import FuzzyController, plot_input_terms
terms = np.linspace(0.0, 1.0, 5)[:, None] + np.array([-0.25, 0.0, 0.25])
controller = FuzzyController(
    input_terms=terms, output_terms=100 * terms, rules=((0,) * 5,) * 5, output_range=(0.0, 100.0)
)
plot_input_terms(controller)
"""
    # Its lowest version gives a DeprecationWarning on import with a later pyparsing.
    assert "matplotlib" in loaded(drawn, "-W", "ignore::DeprecationWarning")


@pytest.mark.parametrize("package", [posegsa, config, export])
def test_every_name_is_found_and_listed(package):
    assert dir(package) == sorted(package.__all__)
    for name in package.__all__:
        assert getattr(package, name) is getattr(package, name), name
    assert posegsa.load_config is config.load


@pytest.mark.parametrize("package", [posegsa, config, export])
def test_a_name_that_is_not_there_is_an_attribute_error(package):
    with pytest.raises(AttributeError, match=f"No {package.__name__} attribute nam"):
        _ = package.nam
    assert not hasattr(package, "__wrapped__")


@pytest.mark.parametrize("name", ["config", "runtime"])
def test_public_modules_need_no_import_of_their_own(name):
    code = f"import posegsa; posegsa.{name}.__name__"
    assert "pydantic" not in loaded(code)
    assert getattr(posegsa, name) is import_module(f"posegsa.{name}")


def test_the_stubs_are_installed_beside_the_packages():
    for package in (posegsa, config, export):
        assert Path(package.__file__).with_name("__init__.pyi").is_file()


def test_every_format_has_its_writer():
    for form in FORMATS.values():
        writer = resolve_name(form.writer)
        assert getattr(posegsa, writer.__name__) is writer
