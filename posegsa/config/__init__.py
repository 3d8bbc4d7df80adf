"""The typed description of an experiment, and its way to and from TOML.

Every constant of the paper, and every one that it leaves out, is a default here and nowhere else.
`Experiment()` is the recommended experiment.
"""

from posegsa.config.experiment import (
    CheckpointConfig,
    CostConfig,
    Experiment,
    FilterConfig,
    ObjectiveConfig,
    RunConfig,
)
from posegsa.config.family import FamilyConfig, Occasions
from posegsa.config.files import as_experiment, from_dict, load, override, to_toml
from posegsa.config.scenario import Landmark, Profile, ScenarioConfig, Sine, Vector
from posegsa.config.schedule import (
    INPUT_RANGE,
    PARAMETERS,
    TERMS,
    FuzzyConfig,
    GainConfig,
    ParametersConfig,
    triangles,
)

__all__ = [
    "INPUT_RANGE",
    "PARAMETERS",
    "TERMS",
    "CheckpointConfig",
    "CostConfig",
    "Experiment",
    "FamilyConfig",
    "FilterConfig",
    "FuzzyConfig",
    "GainConfig",
    "Landmark",
    "ObjectiveConfig",
    "Occasions",
    "ParametersConfig",
    "Profile",
    "RunConfig",
    "ScenarioConfig",
    "Sine",
    "Vector",
    "as_experiment",
    "from_dict",
    "load",
    "override",
    "to_toml",
    "triangles",
]
