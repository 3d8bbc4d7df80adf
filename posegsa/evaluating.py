"""`posegsa evaluate`: a finished run on many unseen scenarios, beside every baseline."""

from collections.abc import Callable
from dataclasses import replace

import jax

from posegsa.arguments import check_callable, check_type, check_whole
from posegsa.judging.baselines import Described, baselines
from posegsa.judging.evaluation import CONTENDERS, TUNED, contender, evaluation
from posegsa.judging.metrics import error_tracks
from posegsa.judging.result import TuneResult
from posegsa.search import memory
from posegsa.search.build import scenario, scenario_batch
from posegsa.search.keys import held_out_keys
from posegsa.settings.fields import MAX_COUNT


def evaluate(
    result: TuneResult,
    *,
    scenarios: int = 1000,
    seed: int | None = None,
    progress: Callable[[str], object] | None = None,
) -> TuneResult:
    """Judge a tuned schedule on unseen scenarios beside all baselines.

    Random search and the smooth schedule are searched on the run's training scenarios with the
    run's number of evaluations; the best constant gain is the run's. The scenarios that judge are
    drawn with keys that no search has seen.

    Args:
        result: A tuned result.
        scenarios: Number of held-out scenarios, at least 2.
        seed: Another held-out set than the run's own.
        progress: Told in words what is done next.

    Returns:
        The result with its evaluation replaced.

    Raises:
        ArgumentError: Fewer than 2 scenarios, or an argument of another type.
        MemoryLimitError: So many scenarios would need more memory than there is.
    """
    check_type("result", result, TuneResult)
    check_whole("scenarios", scenarios, 2, MAX_COUNT)
    if seed is not None:
        check_whole("seed", seed, 0, 2**31 - 1)
    check_callable("progress", progress)
    experiment = result.experiment
    memory.check([experiment], held_out=scenarios)
    say = progress if progress is not None else lambda _: None
    with jax.enable_x64(experiment.run.dtype == "float64"):
        one = scenario(experiment)
        k = result.parameters.tolist()
        schedules: dict[str, Described] = {TUNED: (result.schedule, {"kind": "fuzzy", "k": k})}
        for name, find in baselines(result, one).items():
            say(f"searching: {name}")
            schedules[name] = find()
        unseen = held_out_keys(experiment.run.seed, scenarios, seed)
        held_out = scenario_batch(experiment, one, unseen)
        contenders = {}
        for name in sorted(schedules, key=CONTENDERS.index):
            say(f"judging: {name}")
            schedule, description = schedules[name]
            contenders[name] = contender(error_tracks(schedule, held_out), held_out, description)
        return replace(result, evaluation=evaluation(contenders, held_out, seed))
