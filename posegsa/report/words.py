"""What was run, in words."""

from collections.abc import Collection, Iterator

from posegsa.config import Experiment, FamilyConfig
from posegsa.judging.result import TuneResult
from posegsa.report.markup import Html, element, join
from posegsa.settings.fields import Section
from posegsa.words import counted, toml


def what_was_run(result: TuneResult) -> Iterator[tuple[str, str]]:
    """The parts of a run by name, each in a few sentences or as its settings."""
    experiment = result.experiment
    yield "Search", _search(result)
    yield "Objective", join(_settings(experiment.objective), ", ")
    yield "Scenarios", _scenarios(experiment)
    yield "Filter", join(_settings(experiment.filter), ", ")
    yield "Gain", join(_settings(experiment.gain), ", ")
    yield "Inference", join(_settings(experiment.fuzzy, without=["rules"]), ", ")
    yield "Judged on", _judged(result)


def _search(result: TuneResult) -> str:
    run, search = result.experiment.run, result.experiment.search
    return (
        f"{search.title} with {search.size_in_words(' over ')} minimised "
        f"the cost on {counted(run.training_scenarios, 'training scenario')}. It made "
        f"{counted(result.evaluations, 'evaluation')} in {result.search_seconds:.2f} s, after "
        f"{result.compile_seconds:.2f} s of compiling; {result.non_finite or 'none'} of them had "
        f"no finite cost. Seed {run.seed}, {run.dtype}."
    )


def _scenarios(experiment: Experiment) -> Html:
    scenario, family, usual = experiment.scenario, experiment.family, FamilyConfig()
    cross = " and the cross product of the first two" if experiment.filter.cross_vector else ""
    same = [name for name, value in family if value == getattr(usual, name)]
    return join(
        [
            f"{scenario.duration:g} s, sampled every {scenario.sampling_time:g} s, with "
            f"{counted(len(scenario.vectors), 'measured vector')}{cross}, and "
            f"{counted(len(scenario.landmarks), 'landmark')}. Scenarios differ in ",
            join(["their noise", *_settings(family, without=same)], ", "),
            ".",
        ]
    )


def _settings(section: Section, without: Collection[str] = ()) -> list[Html]:
    """The settings of a section, with the meaning of each where its name is pointed at."""
    return [
        join([element("abbr", name, title=description), f" = {toml(value)}"])
        for name, value, description in section.described()
        if name not in without
    ]


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
