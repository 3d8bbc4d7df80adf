"""posegsa's exceptions. Catch `PosegsaError` to catch all but `SearchInterrupted`."""

from typing import Any


class PosegsaError(Exception):
    """Base class of all errors about invalid input."""


class ConfigError(PosegsaError, ValueError):
    """A configuration that cannot be read or is invalid; names key, value and allowed values."""


class RunFolderError(PosegsaError, OSError):
    """A run folder that cannot be used: not writable, or with another run or no run in it."""


class CheckpointError(RunFolderError):
    """A checkpoint that cannot be read or written, or that belongs to something else."""


class DamagedCheckpointError(CheckpointError):
    """A checkpoint whose content has changed since it was written."""


class ArgumentError(PosegsaError, ValueError):
    """An invalid argument; names it, and what is allowed."""


class MemoryLimitError(ConfigError):
    """A configuration that needs more memory than available; names the numbers responsible."""


class SearchError(PosegsaError, RuntimeError):
    """A search that failed before its end; says how to continue from its last checkpoint."""


class MeasurementError(PosegsaError, ValueError):
    """Measurement arrays that the filter cannot use; names the argument."""


class RecordingError(MeasurementError):
    """A recording that cannot be read or used as asked; names the file or the argument."""


class FuzzyError(PosegsaError, ValueError):
    """Invalid terms, rules or parameters of a fuzzy controller; names them."""


class SaveError(RunFolderError):
    """A finished result that could not be written; `result` holds it."""

    def __init__(self, message: str, result: Any) -> None:
        super().__init__(message)
        self.result = result


class SearchInterrupted(KeyboardInterrupt):
    """A search that a signal stopped after it had saved its state; says how to continue.

    Not a `PosegsaError`: like every KeyboardInterrupt, `except Exception` does not catch it.
    """

    def __init__(self, message: str, signal_number: int) -> None:
        super().__init__(message)
        self.signal_number = signal_number


class PosegsaWarning(UserWarning):
    """A warning to the user: an input was changed, or a result may mislead."""
