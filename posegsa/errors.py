"""The exceptions that posegsa raises on purpose: catch `PosegsaError` to catch them all."""


class PosegsaError(Exception):
    """Base of every error that posegsa raises because of what it was given."""


class ConfigError(PosegsaError, ValueError):
    """A configuration that cannot be read or is not valid; names key, value and what is allowed."""


class ScenarioError(PosegsaError, ValueError):
    """A scenario that cannot be estimated, such as one whose pose is not observable."""


class RunFolderError(PosegsaError, OSError):
    """A run folder that cannot be used: not writable, holding another run, or holding none."""


class MeasurementError(PosegsaError, ValueError):
    """Measurement arrays that the filter cannot use; names the argument."""


class FuzzyError(PosegsaError, ValueError):
    """Terms, rules or parameters that make no fuzzy controller; names what does not fit."""


class PosegsaWarning(UserWarning):
    """Something that posegsa changed in what it was given, and went on."""
