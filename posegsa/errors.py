"""The exceptions that posegsa raises on purpose: catch `PosegsaError` to catch them all."""

from typing import Any


class PosegsaError(Exception):
    """Base of every error that posegsa raises because of what it was given."""


class ConfigError(PosegsaError, ValueError):
    """A configuration that cannot be read or is not valid; names key, value and what is allowed."""


class ScenarioError(PosegsaError, ValueError):
    """A scenario that cannot be estimated, such as one whose pose is not observable."""


class RunFolderError(PosegsaError, OSError):
    """A run folder that cannot be used: not writable, holding another run, or holding none."""


class CheckpointError(RunFolderError):
    """A checkpoint that cannot be read or written, or that belongs to something else."""


class DamagedCheckpointError(CheckpointError):
    """A checkpoint whose content is not what was written."""


class ArgumentError(PosegsaError, ValueError):
    """An argument that a function cannot use; names it, and what is allowed."""


class MemoryLimitError(ConfigError):
    """A configuration that would need more memory than there is; says which numbers make it so."""


class SearchError(PosegsaError, RuntimeError):
    """A search that stopped half way; says how to go on from what it had found."""


class MeasurementError(PosegsaError, ValueError):
    """Measurement arrays that the filter cannot use; names the argument."""


class RecordingError(MeasurementError):
    """A recording that cannot be read or used as asked; names the file or the argument."""


class FuzzyError(PosegsaError, ValueError):
    """Terms, rules or parameters that make no fuzzy controller; names what does not fit."""


class SaveError(RunFolderError):
    """A finished result that could not be written; it is not lost: `result` has it."""

    def __init__(self, message: str, result: Any) -> None:
        super().__init__(message)
        self.result = result


class SearchInterrupted(KeyboardInterrupt):
    """A search that was asked to stop, and has saved what it had; says how to go on.

    Not a `PosegsaError`: like every KeyboardInterrupt it passes by `except Exception`.
    """

    def __init__(self, message: str, signal_number: int) -> None:
        super().__init__(message)
        self.signal_number = signal_number


class PosegsaWarning(UserWarning):
    """Something that a user should know: an input that was changed, a result that may mislead."""
