"""The configurations that come with posegsa, by name: the files of configs/."""

import re
from pathlib import Path

from posegsa.errors import ConfigError
from posegsa.words import meant

_NAME = re.compile(r"\w+")


def names() -> list[str]:
    """The names of the configurations."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def find(name: str, *, files: bool = False) -> Path:
    """The file of a configuration.

    Args:
        name: The name of the configuration.
        files: Whether the caller accepts files too; only for the error message.

    Raises:
        ConfigError: There is no configuration with that name.
    """
    if name not in names():
        no_file, a_file = ("no file, and ", "a TOML file, or ") if files else ("", "")
        raise ConfigError(
            f"{name}: {no_file}no configuration of posegsa; allowed: {a_file}{', '.join(names())}"
            f"{meant(name.lower(), names())}"
        )
    return _folder() / f"{name}.toml"


def path_of(given: str | Path) -> str | Path:
    """The file for an argument, a path or the name of a configuration of posegsa.

    Raises:
        ConfigError: It is neither.
    """
    if _NAME.fullmatch(str(given)) and not (there(given) and Path(given).is_file()):
        return find(str(given), files=True)
    return given


def there(given: str | Path) -> bool:
    """Whether a path exists; False for names that are too long for a file."""
    try:
        return Path(given).exists()
    except OSError:  # before Python 3.14
        return False


def about(name: str) -> str:
    """The purpose of a configuration: the first sentence of its file's initial comment.

    Raises:
        ConfigError: There is no configuration with that name.
    """
    lines = find(name).read_text("utf-8").splitlines()
    comment = []
    for line in lines:
        if not line.startswith("#"):
            break
        comment.append(line.removeprefix("#").strip())
    return " ".join(comment).partition(". ")[0].removesuffix(".")


def _folder() -> Path:
    """The folder of the files: inside the package in a wheel, beside it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"
