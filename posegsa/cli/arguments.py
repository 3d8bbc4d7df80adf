"""Arguments that commands of the command line share."""

import argparse
from collections.abc import Callable


def add_config(parser: argparse.ArgumentParser, otherwise: str = "") -> None:
    """CONFIG, which may be left out.

    Args:
        parser: The command's.
        otherwise: What else is meant without it than the recommended experiment.
    """
    parser.add_argument(
        "config",
        nargs="?",
        metavar="CONFIG",
        help=f"TOML file of the experiment; without it, the recommended experiment{otherwise}",
    )


def add_settings(parser: argparse.ArgumentParser, example: str) -> None:
    """--set, as often as wanted."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help=f"replaces a value of the experiment, e.g. {example}; may be given again",
    )


def add_folder(parser: argparse.ArgumentParser, what: str, replaced: str) -> None:
    """--out and --overwrite.

    Args:
        parser: The command's.
        what: What is said of the folder.
        replaced: What --overwrite replaces.
    """
    parser.add_argument("--out", metavar="DIR", help=what)
    parser.add_argument("--overwrite", action="store_true", help=f"replace {replaced}")


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """--quiet."""
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def whole_number(minimum: int, maximum: int | None = None) -> Callable[[str], int]:
    """What reads an argument as a whole number that keeps to these bounds."""
    allowed = f"a whole number from {minimum}" + ("" if maximum is None else f" to {maximum}")

    def read(text: str) -> int:
        inside = text.isdecimal() and minimum <= int(text)
        if not inside or (maximum is not None and int(text) > maximum):
            raise argparse.ArgumentTypeError(f"{text!r}; allowed: {allowed}")
        return int(text)

    return read


def numbers(text: str) -> list[float]:
    """Read an argument as numbers with commas between."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: numbers, commas between") from None
