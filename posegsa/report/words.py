"""What was run, in words."""

from collections.abc import Iterator

from posegsa.config import Experiment, ObjectiveConfig
from posegsa.judging.result import TuneResult
from posegsa.words import counted


def what_was_run(result: TuneResult) -> Iterator[tuple[str, str]]:
    """The parts of a run by name, each described in a few sentences."""
    yield "Search", _search(result)
    yield "Scenarios", _scenarios(result.experiment)
    yield "Filter", _filter(result.experiment)
    yield "Gain", _gain(result.experiment)
    yield "Judged on", _judged(result)


def _search(result: TuneResult) -> str:
    run, search = result.experiment.run, result.experiment.search
    over = counted(run.training_scenarios, "training scenario")
    bad = result.non_finite
    return (
        f"{search.title} with {search.size_in_words(' over ')} minimised "
        f"{_objective(result.experiment.objective)} {over}. It made "
        f"{counted(result.evaluations, 'evaluation')} in {result.search_seconds:.2f} s, "
        f"after {result.compile_seconds:.2f} s of compiling; {bad or 'none'} of them had no finite "
        f"cost. Seed {run.seed}, {run.dtype}."
    )


def _objective(objective: ObjectiveConfig) -> str:
    return {
        "mean": "the mean cost over",
        "median": "the median cost over",
        "worst": "the largest cost over",
        "cvar": f"the mean cost of the worst {100 * (1 - objective.level):g} % of",
        "mean_std": f"the mean plus {objective.factor:g} standard deviations of the cost over",
    }[objective.name]


def _scenarios(experiment: Experiment) -> str:
    scenario, family = experiment.scenario, experiment.family
    cross = " and the cross product of the first two" if scenario.cross_vector else ""
    varied = []
    for ends, name, unit in (
        (family.attitude_error, "the initial attitude error about a random axis", " deg"),
        (family.position_error, "the initial position error in a random direction", " m"),
        (family.bias_scale, "the velocity biases", " times the nominal"),
        (family.noise_scale, "the noise", " times the nominal"),
        (family.motion_scale, "the amplitude of the motion", " times the nominal"),
    ):
        if ends != "off":
            varied.append(f"{name} ({ends[0]:g} to {ends[1]:g}{unit})")
    if family.landmark_spread:
        varied.append(f"the landmarks (by up to {family.landmark_spread:g} m in each coordinate)")
    if family.random_phase:
        varied.append("the phase of the motion")
    differs = (
        f"Beside the noise, scenarios differ in {'; '.join(varied)}."
        if varied
        else "Scenarios differ in their noise alone."
    )
    return (
        f"{scenario.duration:g} s, sampled every {scenario.sampling_time:g} s, with "
        f"{counted(len(scenario.vectors), 'measured vector')}{cross}, and "
        f"{counted(len(scenario.landmarks), 'landmark')}. {differs}"
    )


def _filter(experiment: Experiment) -> str:
    settings = experiment.filter
    law = (
        "The gradient law, for which the Lyapunov argument holds"
        if settings.law == "gradient"
        else "The law as the paper prints it, which can diverge"
    )
    both = settings.gamma if isinstance(settings.gamma, tuple) else (settings.gamma,)
    gamma = " and ".join(f"{gamma:g}" for gamma in both)
    limit = (
        "no gain limit"
        if settings.gain_limit == "off"
        else f"gain limit {settings.gain_limit:g} (steps above 2 are unstable)"
    )
    return (
        f"{law}; bias gain gamma = {gamma} 1/s\u00b2; {counted(settings.substeps, 'inner step')} "
        f"per sample; {limit}."
    )


def _gain(experiment: Experiment) -> str:
    gain, fuzzy = experiment.gain, experiment.fuzzy
    seen = {
        "measured": "the errors of the measured vectors and landmarks, which a vehicle has",
        "pose": "the true errors in attitude and position, an oracle that no vehicle has",
    }[gain.signal]
    smoothed = (
        f"after a low-pass filter of {gain.smoothing:g} s" if gain.smoothing else "unfiltered"
    )
    idle = {"hold": "the last gain is held", "midrange": "it is the middle of its range"}
    centroid = (
        "exact centroid"
        if fuzzy.centroid == "exact"
        else f"centroid of {fuzzy.sampled_points} samples"
    )
    return (
        f'The schedule sees {seen} (signal "{gain.signal}"), {smoothed}, with error scale '
        f"{gain.error_scale:g} and rate scale {gain.rate_scale:g}. Mamdani inference, {centroid}; "
        f"where no rule fires, {idle[fuzzy.no_rule]}."
    )


def _judged(result: TuneResult) -> str:
    evaluation = result.evaluation
    which = (
        "the run's own held-out set"
        if evaluation.seed is None
        else f"held-out set number {evaluation.seed}"
    )
    return (
        f"{counted(evaluation.scenarios, 'scenario')} of the same family, {which}, drawn with keys "
        "that the search never saw; every contender met the same ones. Intervals of 95 % are "
        "normal approximations over scenarios, of differences over pairs."
    )
