"""A nonlinear pose filter on SE(3) with a fuzzy gain schedule, tuned by gravitational search.

Data flow: config -> scenarios (truth + measurements) -> filter step + fuzzy gain -> rollout -> cost
-> population (agents x scenarios) -> optimiser -> result -> held-out evaluation -> figures.

Importing it changes nothing in the process. `enable_fast_path()`, called first, makes CPUs fast.
"""

from posegsa.comparing import compare
from posegsa.config import Experiment
from posegsa.config import load as load_config
from posegsa.errors import PosegsaError, PosegsaWarning, SearchInterrupted
from posegsa.evaluating import evaluate
from posegsa.export import export_c, export_csv, export_json
from posegsa.figures.result import draw
from posegsa.figures.schedule import plot_input_terms, plot_output_terms, plot_surface
from posegsa.judging.comparison import OptimiserComparison
from posegsa.judging.result import VERSION as __version__
from posegsa.judging.result import TuneBatch, TuneResult
from posegsa.model.filter import FilterSettings, FilterState, initial_state, step
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import Estimates, begin, run_filter, scheduled_step
from posegsa.model.schedules import ConstantGain, FuzzyGain
from posegsa.model.signal import SignalSettings
from posegsa.optimisers import (
    GSA,
    Adam,
    DifferentialEvolution,
    Optimiser,
    ParticleSwarm,
    RandomSearch,
    box,
    minimise,
)
from posegsa.runtime import enable_fast_path
from posegsa.saving.checkpoint import load_search, save_search
from posegsa.saving.comparison import load_comparison
from posegsa.saving.run import load, save
from posegsa.search.build import filter_settings, parameter_space, signal_settings
from posegsa.tuning import tune, tune_batch

__all__ = [
    "GSA",
    "Adam",
    "ConstantGain",
    "DifferentialEvolution",
    "Estimates",
    "Experiment",
    "FilterSettings",
    "FilterState",
    "FuzzyController",
    "FuzzyGain",
    "Measurements",
    "Optimiser",
    "OptimiserComparison",
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
    "draw",
    "enable_fast_path",
    "evaluate",
    "export_c",
    "export_csv",
    "export_json",
    "filter_settings",
    "initial_state",
    "load",
    "load_comparison",
    "load_config",
    "load_search",
    "minimise",
    "parameter_space",
    "plot_input_terms",
    "plot_output_terms",
    "plot_surface",
    "run_filter",
    "save",
    "save_search",
    "scheduled_step",
    "signal_settings",
    "step",
    "tune",
    "tune_batch",
]
