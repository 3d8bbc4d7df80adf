"""The gain's controller alone, in the formats of other fuzzy tools (`posegsa.exchange`).

The comment at the head of each file says how its inputs are formed from measurements, with the
run's scales, and what the schedule is worth.
"""

from collections.abc import Callable

from posegsa.arguments import check_type
from posegsa.exchange.fis import to_fis
from posegsa.exchange.fll import to_fll
from posegsa.export.c_gain import signal_in_words
from posegsa.export.c_text import origin, worth
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.model.fuzzy import FuzzyController


def export_fis(source: TuneResult | RecordingResult | FuzzyController) -> str:
    """The gain's controller for MATLAB's Fuzzy Logic Toolbox.

    Args:
        source: A tuned result, whose comment says where it comes from, or any controller.

    Raises:
        ArgumentError: It is neither, or a result whose gain is no fuzzy controller's.
    """
    return _written(source, to_fis)


def export_fll(source: TuneResult | RecordingResult | FuzzyController) -> str:
    """The gain's controller for fuzzylite; arguments as `export_fis`."""
    return _written(source, to_fll)


def _written(
    source: TuneResult | RecordingResult | FuzzyController, write: Callable[..., str]
) -> str:
    check_type("source", source, TuneResult, RecordingResult, FuzzyController)
    if isinstance(source, FuzzyController):
        return write(source)
    return write(source.controller, _about(source))


def _about(result: TuneResult | RecordingResult) -> list[str]:
    """Where a schedule comes from, what it is worth and how its inputs are formed."""
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
