"""The typed description of an experiment, and its way to and from TOML.

Every constant of the paper, and every one that it leaves out, is a default here and nowhere else.
`Experiment()` is the recommended experiment.
"""

from posegsa.config.experiment import CheckpointConfig as CheckpointConfig
from posegsa.config.experiment import CostConfig as CostConfig
from posegsa.config.experiment import Experiment as Experiment
from posegsa.config.experiment import FilterConfig as FilterConfig
from posegsa.config.experiment import ObjectiveConfig as ObjectiveConfig
from posegsa.config.experiment import RunConfig as RunConfig
from posegsa.config.family import FamilyConfig as FamilyConfig
from posegsa.config.family import Occasions as Occasions
from posegsa.config.files import as_experiment as as_experiment
from posegsa.config.files import from_dict as from_dict
from posegsa.config.files import load as load
from posegsa.config.files import override as override
from posegsa.config.files import to_toml as to_toml
from posegsa.config.files import with_tuned as with_tuned
from posegsa.config.imu import ImuConfig as ImuConfig
from posegsa.config.imu import ImuObserverConfig as ImuObserverConfig
from posegsa.config.imu import ImuVectorsConfig as ImuVectorsConfig
from posegsa.config.imu import load_imu as load_imu
from posegsa.config.scenario import Landmark as Landmark
from posegsa.config.scenario import ScenarioConfig as ScenarioConfig
from posegsa.config.scenario import Sine as Sine
from posegsa.config.scenario import Sines as Sines
from posegsa.config.scenario import Vector as Vector
from posegsa.config.schedule import DEFAULT_ALSO as DEFAULT_ALSO
from posegsa.config.schedule import INPUT_RANGE as INPUT_RANGE
from posegsa.config.schedule import PARAMETERS as PARAMETERS
from posegsa.config.schedule import SEARCHED as SEARCHED
from posegsa.config.schedule import TERMS as TERMS
from posegsa.config.schedule import FuzzyConfig as FuzzyConfig
from posegsa.config.schedule import GainConfig as GainConfig
from posegsa.config.schedule import ParametersConfig as ParametersConfig
from posegsa.config.schedule import Rules as Rules
from posegsa.config.schedule import triangles as triangles
