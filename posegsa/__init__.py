"""A nonlinear pose filter on SE(3) with a fuzzy gain schedule, tuned by gravitational search.

Data flow: config -> scenarios (truth + measurements) -> filter step + fuzzy gain -> rollout -> cost
-> population (agents x scenarios) -> optimiser -> result -> held-out evaluation -> figures.

Importing it changes nothing in the process. `enable_fast_path()`, called first, makes CPUs fast.
"""

from posegsa import config
from posegsa.comparing import compare as compare
from posegsa.config import Experiment as Experiment
from posegsa.errors import PosegsaError as PosegsaError
from posegsa.errors import PosegsaWarning as PosegsaWarning
from posegsa.errors import RecordingError as RecordingError
from posegsa.errors import SearchInterrupted as SearchInterrupted
from posegsa.evaluating import evaluate as evaluate
from posegsa.exchange import load_controller as load_controller
from posegsa.export import export_c as export_c
from posegsa.export import export_c_gain as export_c_gain
from posegsa.export import export_csv as export_csv
from posegsa.export import export_fcl as export_fcl
from posegsa.export import export_fis as export_fis
from posegsa.export import export_fll as export_fll
from posegsa.export import export_fml as export_fml
from posegsa.export import export_json as export_json
from posegsa.export import filter_to_c as filter_to_c
from posegsa.figures.result import draw as draw
from posegsa.figures.schedule import plot_input_terms as plot_input_terms
from posegsa.figures.schedule import plot_output_terms as plot_output_terms
from posegsa.figures.schedule import plot_surface as plot_surface
from posegsa.imu_tuning import tune_imu as tune_imu
from posegsa.judging.comparison import OptimiserComparison as OptimiserComparison
from posegsa.judging.imu import ImuResult as ImuResult
from posegsa.judging.recorded import RecordingResult as RecordingResult
from posegsa.judging.recorded import by_hand as by_hand
from posegsa.judging.result import VERSION
from posegsa.judging.result import TuneBatch as TuneBatch
from posegsa.judging.result import TuneResult as TuneResult
from posegsa.model.filter import FilterSettings as FilterSettings
from posegsa.model.filter import FilterState as FilterState
from posegsa.model.filter import initial_state as initial_state
from posegsa.model.filter import step as step
from posegsa.model.fuzzy import FuzzyController as FuzzyController
from posegsa.model.measurements import Measurements as Measurements
from posegsa.model.rollout import Estimates as Estimates
from posegsa.model.rollout import begin as begin
from posegsa.model.rollout import scheduled_step as scheduled_step
from posegsa.model.schedules import ConstantGain as ConstantGain
from posegsa.model.schedules import FuzzyGain as FuzzyGain
from posegsa.model.signal import SignalSettings as SignalSettings
from posegsa.optimisers import GSA as GSA
from posegsa.optimisers import Adam as Adam
from posegsa.optimisers import DifferentialEvolution as DifferentialEvolution
from posegsa.optimisers import Optimiser as Optimiser
from posegsa.optimisers import ParticleSwarm as ParticleSwarm
from posegsa.optimisers import RandomSearch as RandomSearch
from posegsa.optimisers import box as box
from posegsa.optimisers import minimise as minimise
from posegsa.recordings.accuracy import attitude_errors as attitude_errors
from posegsa.recordings.accuracy import position_errors as position_errors
from posegsa.recordings.accuracy import recording_errors as recording_errors
from posegsa.recordings.accuracy import rmse as rmse
from posegsa.recordings.imu import as_imu as as_imu
from posegsa.recordings.imu import imu as imu
from posegsa.recordings.imu_filter import run_imu as run_imu
from posegsa.recordings.recording import Recording as Recording
from posegsa.recordings.running import run_filter as run_filter
from posegsa.recordings.start import Start as Start
from posegsa.recordings.tum import tum_text as tum_text
from posegsa.replaying import replay as replay
from posegsa.runtime import enable_fast_path as enable_fast_path
from posegsa.saving.checkpoint import load_search as load_search
from posegsa.saving.checkpoint import save_search as save_search
from posegsa.saving.comparison import load_comparison as load_comparison
from posegsa.saving.loading import load as load
from posegsa.saving.loading import save as save
from posegsa.saving.recorded import load_recorded as load_recorded
from posegsa.search.build import filter_settings as filter_settings
from posegsa.search.build import parameter_space as parameter_space
from posegsa.search.build import signal_settings as signal_settings
from posegsa.streaming import Pose as Pose
from posegsa.streaming import PoseFilter as PoseFilter
from posegsa.tuning import tune as tune
from posegsa.tuning import tune_batch as tune_batch

__version__ = VERSION
load_config = config.load
