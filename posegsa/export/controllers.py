"""The gain's controller alone, in the formats of other fuzzy tools (`posegsa.exchange`).

The comment at the top of each file explains how its inputs are computed from measurements, with the
run's scales, and how good the schedule is.
"""

from collections.abc import Callable

from posegsa.arguments import check_type
from posegsa.exchange.fis import to_fis
from posegsa.exchange.fll import to_fll
from posegsa.export.c_gain import signal_in_words
from posegsa.export.c_text import origin, worth
from posegsa.judging.result import Result
from posegsa.model.fuzzy import FuzzyController


def export_fis(source: Result | FuzzyController) -> str:
    """The gain's controller for MATLAB's Fuzzy Logic Toolbox.

    Args:
        source: A tuned result, which the comment then describes, or any controller.

    Raises:
        ArgumentError: It is neither, or a result without a fuzzy gain.
    """
    return _written(source, to_fis)


def export_fll(source: Result | FuzzyController) -> str:
    """The gain's controller for fuzzylite; arguments as `export_fis`."""
    return _written(source, to_fll)


def _written(source: Result | FuzzyController, write: Callable[..., str]) -> str:
    check_type("source", source, Result, FuzzyController)
    if isinstance(source, FuzzyController):
        return write(source)
    return write(source.controller, _about(source))


def _about(result: Result) -> list[str]:
    """Where a schedule comes from, how good it is and how its inputs are computed."""
    return [
        "Gain controller of a pose filter.",
        *origin(result),
        "",
        *worth(result),
        "",
        "Inputs, both without a unit:",
        *signal_in_words(result),
        "",
    ]
