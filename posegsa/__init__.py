"""A nonlinear pose filter on SE(3) with a fuzzy gain schedule, tuned by gravitational search.

Data flow: config -> scenarios (truth + measurements) -> filter step + fuzzy gain -> rollout -> cost
-> population (agents x scenarios) -> optimiser -> result -> held-out evaluation -> figures.

Importing it changes nothing in the process. `enable_fast_path()`, called first, makes CPUs fast.
"""

from posegsa.batch import TuneBatch
from posegsa.checkpoint import load_search, save_search
from posegsa.compare import compare
from posegsa.compared import Comparison
from posegsa.config import Experiment
from posegsa.config import load as load_config
from posegsa.errors import PosegsaError, PosegsaWarning, SearchInterrupted
from posegsa.evaluate import evaluate
from posegsa.export import export_c, export_csv, export_json
from posegsa.filter import FilterSettings, FilterState, filter_settings, initial_state, step
from posegsa.fuzzy import FuzzyController
from posegsa.gain import ConstantGain, FuzzyGain, SignalSettings, signal_settings
from posegsa.measurements import Measurements
from posegsa.optimisers import (
    GSA,
    Adam,
    DifferentialEvolution,
    ParticleSwarm,
    RandomSearch,
    box,
    minimise,
)
from posegsa.parameters import parameter_space
from posegsa.plots import plot_input_terms, plot_output_terms, plot_surface
from posegsa.results import VERSION as __version__
from posegsa.results import TuneResult, load
from posegsa.rollout import Estimates, begin, run_filter, scheduled_step
from posegsa.runtime import enable_fast_path
from posegsa.tuning import tune, tune_batch

__all__ = [
    "GSA",
    "Adam",
    "Comparison",
    "ConstantGain",
    "DifferentialEvolution",
    "Estimates",
    "Experiment",
    "FilterSettings",
    "FilterState",
    "FuzzyController",
    "FuzzyGain",
    "Measurements",
    "ParticleSwarm",
    "PosegsaError",
    "PosegsaWarning",
    "RandomSearch",
    "SearchInterrupted",
    "SignalSettings",
    "TuneBatch",
    "TuneResult",
    "__version__",
    "begin",
    "box",
    "compare",
    "enable_fast_path",
    "evaluate",
    "export_c",
    "export_csv",
    "export_json",
    "filter_settings",
    "initial_state",
    "load",
    "load_config",
    "load_search",
    "minimise",
    "parameter_space",
    "plot_input_terms",
    "plot_output_terms",
    "plot_surface",
    "run_filter",
    "save_search",
    "scheduled_step",
    "signal_settings",
    "step",
    "tune",
    "tune_batch",
]
