"""`evaluate` on a tiny run, with every baseline."""

import json
import math
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.messages import assert_states
from helpers.results import changed
from helpers.results import evaluation as made_up
from scipy import stats

import posegsa
from posegsa import evaluating
from posegsa.cli.command import main
from posegsa.errors import RunFolderError
from posegsa.evaluating import evaluate
from posegsa.judging import tuned_kalman
from posegsa.judging.baselines import Baseline, baselines
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CLAIRVOYANT,
    CONSTANT,
    CONTENDERS,
    EKF,
    EKF_GATED,
    EKF_ITERATED,
    KALMAN_SEARCH_WORDS,
    NOT_TUNED,
    REPLAYED,
    SMOOTH,
    TUNED,
    UNTUNED,
    Evaluation,
    interval,
)
from posegsa.judging.tuned_kalman import VARIANTS
from posegsa.saving import result_files
from posegsa.saving.records import from_json, to_json
from posegsa.saving.result_files import RESULT, SCHEMA
from posegsa.search.keys import held_out_keys, training_keys
from posegsa.steps import Step

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


FILE = Path("evaluation")
SEARCHED = (EKF, EKF_ITERATED, EKF_GATED)
"""The Kalman filters that are searched here; each of the others takes as long, by the same way."""
EVERY = tuple(name for name in CONTENDERS if name != AS_CONFIGURED)
"""The contenders of a fuzzy gain, which has no numbers but those that are searched."""
BESIDE = tuple(name for name in EVERY if name in SEARCHED or name not in VARIANTS)
"""Those of this file."""
KALMAN_FILTERS = (*SEARCHED, UNTUNED)


@pytest.fixture(scope="module")
def evaluated():
    """A tiny run, evaluated against every baseline; the Kalman filters' searches are cut short.

    There are as many scenarios as in `tune`, so that programs are compiled once.
    """
    patch = pytest.MonkeyPatch()
    patch.setattr(tuned_kalman, "CHECK_INTERVAL", 20)
    patch.setattr(tuned_kalman, "MAX_EVALUATIONS", 40)
    every = evaluating.baselines

    def some(*given: Any) -> dict[str, Baseline]:
        return {name: one for name, one in every(*given).items() if name in BESIDE}

    patch.setattr(evaluating, "baselines", some)
    reports: list[Step] = []
    tuned = posegsa.tune(tiny())
    result = evaluate(tuned, scenarios=3, progress=reports.append)
    yield tuned, result, reports
    patch.undo()


def test_every_contender_but_the_judged_filter_is_a_baseline(evaluated):
    assert {*baselines(tiny(), evaluated[0].filter)} == {*EVERY} - {TUNED}


def about(name: str, reports: list[Step]) -> list[str]:
    """`about` of the parts of a step, in order."""
    return list(dict.fromkeys(step.about for step in reports if step.name == name))


def test_every_baseline_is_judged_on_the_same_scenarios(evaluated):
    _, result, reports = evaluated
    contenders = result.on_scenarios.evaluation.contenders
    assert tuple(contenders) == BESIDE
    found_by_tune = {TUNED, CONSTANT, UNTUNED}
    assert set(about("searching", reports)) == {*BESIDE} - found_by_tune
    assert about("judging", reports) == [*BESIDE, CLAIRVOYANT]
    starts = [c.metrics.initial_angle for n, c in contenders.items() if n != UNTUNED]
    assert all(len(s) == 3 for s in starts)
    for start in starts:
        np.testing.assert_allclose(start, starts[0], atol=1e-3)
    for name, contender in contenders.items():
        assert (contender.filter.kind == "kalman") == (name in KALMAN_FILTERS)
        assert np.isfinite(contender.metrics.cost).all()


def test_what_was_found_is_not_searched_again(evaluated):
    _, result, _ = evaluated
    reports: list[Step] = []
    again = evaluate(result, scenarios=3, progress=reports.append)
    assert {step.name for step in reports} == {"preparing", "judging"}
    assert about("judging", reports) == [*BESIDE, CLAIRVOYANT]
    for name, contender in again.on_scenarios.evaluation.contenders.items():
        before = result.on_scenarios.evaluation.contenders[name]
        assert contender.filter == before.filter
        np.testing.assert_array_equal(contender.metrics.cost, before.metrics.cost)


def without_the_replay(result: posegsa.Result) -> posegsa.Result:
    """A result that lacks one baseline."""
    judged = result.on_scenarios
    assert judged is not None
    known = {n: c for n, c in judged.evaluation.contenders.items() if n != REPLAYED}
    before = replace(judged, evaluation=replace(judged.evaluation, contenders=known))
    return replace(result, on_scenarios=before)


def test_the_command_judges_a_finished_run(evaluated, tmp_path, capsys):
    """One baseline is missing and must be searched."""
    result, folder = evaluated[1], tmp_path / "run"
    posegsa.save(without_the_replay(result), folder, figures=())
    tables = {name: folder / f"{name}.csv" for name in ("history", "trajectory")}
    before_csv = {name: path.read_bytes() for name, path in tables.items()}
    arguments = ["--scenarios", "3", "--seed", "2", "--figures", "costs,bands,vector_biases"]
    assert main(["evaluate", str(folder), *arguments]) == 0
    said = capsys.readouterr()
    assert f"searching {REPLAYED} ..." in said.err
    for contender in BESIDE:
        assert contender in said.out
        assert contender in said.err, "long work states what it does"
    assert "judging: done after" in said.err
    stored = json.loads((folder / RESULT).read_text())["on_scenarios"]["evaluation"]
    assert stored["seed"] == 2
    assert tuple(stored["contenders"]) == BESIDE
    again = posegsa.load(folder).on_scenarios
    assert again is not None
    assert again.evaluation.scenarios == 3
    report = (folder / "report.html").read_text()
    assert "invariant EKF" in report
    assert KALMAN_SEARCH_WORDS in report
    assert {name: path.read_bytes() for name, path in tables.items()} == before_csv
    drawn = {path.stem for path in (folder / "figures").iterdir()}
    assert drawn == {"costs", "bands"}, "no biases of vectors are estimated"
    assert (folder / "evaluation.txt").read_text().strip() in said.out


def test_a_judgement_is_kept_if_nobody_reads_what_is_printed(evaluated, tmp_path, monkeypatch):
    result, folder = evaluated[1], tmp_path / "run"
    posegsa.save(without_the_replay(result), folder, figures=())
    monkeypatch.setattr(evaluating, "evaluate", lambda *_, **__: result)
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", encoding="utf-8") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert main(["evaluate", str(folder), "--figures", "costs"]) == 1
        monkeypatch.undo()
    assert tuple(posegsa.load(folder).on_scenarios.evaluation.contenders) == BESIDE


def test_a_judgement_that_can_not_be_written_is_printed(evaluated, tmp_path, monkeypatch, capsys):
    result, folder = evaluated[1], tmp_path / "run"
    posegsa.save(result, folder, figures=())

    def full(*_: Any, **__: Any) -> None:
        raise RunFolderError(f"{folder}: no space left")

    monkeypatch.setattr(evaluating, "evaluate", lambda *_, **__: result)
    monkeypatch.setattr(result_files, "write_result", full)
    assert main(["evaluate", str(folder), "--figures", "costs"]) == 2
    out, err = capsys.readouterr()
    assert result.on_scenarios.evaluation.table() in out
    assert err.endswith(f"posegsa: {folder}: no space left\n")


def test_a_filter_that_was_not_searched_is_not_called_tuned(monkeypatch, tmp_path):
    every = evaluating.baselines
    monkeypatch.setattr(
        evaluating,
        "baselines",
        lambda *given: {SMOOTH: every(*given)[SMOOTH]},  # the one that it is compared with
    )
    by_hand = posegsa.configured(tiny(), schedule=posegsa.ConstantGain(np.float32(8.0)))  # type: ignore[arg-type]  # a NumPy scalar will do for an array
    result = evaluate(by_hand, scenarios=3)
    assert result.on_scenarios is not None
    contenders = result.on_scenarios.evaluation.contenders
    assert [*contenders] == [NOT_TUNED, SMOOTH]
    assert contenders[NOT_TUNED].filter.evaluations == 0
    posegsa.save(result, tmp_path / "judged", figures=("costs", "bands"))
    assert posegsa.load(tmp_path / "judged").filter == by_hand.filter
    for name in ("evaluation.txt", "summary.txt", "report.html"):
        text = (tmp_path / "judged" / name).read_text()
        assert NOT_TUNED in text.lower()
        assert TUNED not in text.lower(), name


def test_the_first_held_out_scenarios_are_those_that_tune_judged_on(evaluated):
    tuned, result, _ = evaluated
    for name in (TUNED, CONSTANT):
        few = tuned.on_scenarios.evaluation.contenders[name].metrics.cost
        many = result.on_scenarios.evaluation.contenders[name].metrics.cost
        np.testing.assert_allclose(many[: len(few)], few, rtol=1e-4)


def test_another_seed_is_another_held_out_set():
    experiment = tiny()
    own, other, training = (
        {tuple(k) for k in jax.random.key_data(keys).tolist()}
        for keys in (
            held_out_keys(experiment.run.seed, 1000),
            held_out_keys(experiment.run.seed, 1000, 0),
            training_keys(experiment.run.seed, experiment.run.training_scenarios),
        )
    )
    assert len(own | other | training) == 2003


def test_differences_are_paired(evaluated):
    evaluation = evaluated[1].on_scenarios.evaluation
    tuned, constant = (evaluation.contenders[n].metrics.cost for n in (TUNED, CONSTANT))
    found = evaluation.difference(CONSTANT)
    assert found.mean == pytest.approx(np.mean(tuned - constant))
    assert found.low < found.mean < found.high
    half = stats.t.ppf(0.975, 2) * np.std(tuned - constant, ddof=1) / math.sqrt(3)
    assert found.high - found.mean == pytest.approx(half)


def test_json_gives_everything_back(evaluated):
    evaluation = evaluated[1].on_scenarios.evaluation
    again = from_json(Evaluation, to_json(evaluation, SCHEMA), SCHEMA, FILE)
    assert again.table() == evaluation.table()
    assert list(again.contenders) == list(evaluation.contenders)
    for name, contender in evaluation.contenders.items():
        for a, b in zip(contender.metrics, again.contenders[name].metrics, strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(contender.bands, again.contenders[name].bands, strict=True):
            np.testing.assert_array_equal(a, b)
        assert again.contenders[name].filter == contender.filter


def test_a_diverged_contender_is_reported_and_not_averaged_away(evaluated):
    evaluation = evaluated[1].on_scenarios.evaluation
    first = evaluation.contenders[CONSTANT]
    cost = first.metrics.cost.copy()
    cost[2] = np.inf
    diverged = first.metrics.diverged.copy()
    diverged[2] = True
    metrics = first.metrics._replace(cost=cost, diverged=diverged)
    contenders = evaluation.contenders | {CONSTANT: first._replace(metrics=metrics)}
    bad = replace(evaluation, contenders=contenders)
    assert bad.cost(CONSTANT).mean == math.inf
    assert math.isnan(bad.difference(CONSTANT).low)
    assert "33.3" in bad.table()
    again = from_json(Evaluation, to_json(bad, SCHEMA), SCHEMA, FILE)
    assert again.cost(CONSTANT).mean == math.inf


def test_interval_of_known_values():
    found = interval(np.array([1.0, 2.0, 3.0, 4.0]))
    assert found.mean == 2.5
    spread = np.std([1, 2, 3, 4], ddof=1) / 2
    assert found.high - found.mean == pytest.approx(stats.t.ppf(0.975, 3) * spread)
    assert found.mean - found.low == pytest.approx(found.high - found.mean)
    assert math.isnan(interval(np.array([1.0])).low)


def test_a_percentile_does_not_hide_divergence(evaluated):
    evaluation = evaluated[1].on_scenarios.evaluation
    first = evaluation.contenders[CONSTANT]
    cost = first.metrics.cost.copy()
    cost[2] = np.inf
    contenders = evaluation.contenders | {
        CONSTANT: first._replace(metrics=first.metrics._replace(cost=cost))
    }
    assert replace(evaluation, contenders=contenders).summary(CONSTANT).p95 == math.inf


def test_too_few_scenarios_are_refused(evaluated):
    with pytest.raises(ValueError, match="scenarios = 1"):
        evaluate(evaluated[0], scenarios=1)


def test_the_table_holds_every_contender(evaluated):
    text = evaluated[1].on_scenarios.evaluation.table()
    heads = [line[: len(max(BESIDE, key=len))].strip() for line in text.splitlines()]
    for name in BESIDE:
        assert heads.count(name) == (3 if name in KALMAN_FILTERS else 2)
    assert_states(text.splitlines()[0], "Cost", "3 scenarios")


def test_short_searches_of_kalman_filters_are_said_to_be_short():
    assert KALMAN_SEARCH_WORDS in made_up((TUNED, EKF_GATED)).table()
    assert KALMAN_SEARCH_WORDS not in made_up((TUNED, UNTUNED)).table(), "it was not searched"


def test_the_verdict_names_cheaper_filters_the_lowest_cost_first():
    given = made_up((TUNED, CONSTANT, SMOOTH, EKF))
    spread = np.linspace(-0.1, 0.1, given.scenarios)
    for name, cost in ((TUNED, 5.0), (CONSTANT, 4.0), (SMOOTH, 3.0), (EKF, 6.0)):
        given = changed(given, name, cost=cost + spread * (name != EKF))
    given = changed(given, TUNED, rms_attitude=np.full(given.scenarios, 1.5))
    given = changed(given, TUNED, rms_distance=np.full(given.scenarios, 0.125))
    words = given.verdict()
    assert words.startswith(
        f"Best on {given.scenarios} unseen scenarios: the smooth gain K(e), which errs "
    )
    assert "2 points of cost less (2 to 2) than this filter, 1.5 deg and 12.5 cm" in words
    assert words.index("smooth gain") < words.index("; then the best constant gains, ")
    assert "1 points of cost less" in words
    assert words.endswith("Take the first: `posegsa tune CONFIG --set filter.schedule=smooth`.")
    assert "EKF" not in words


def test_the_verdict_says_where_errors_are_not_finite():
    given = made_up((TUNED, CONSTANT))
    errors = np.full(given.scenarios, 1.5)
    errors[:3] = np.nan
    some = changed(given, TUNED, rms_attitude=errors, rms_distance=np.full(given.scenarios, 0.125))
    words = "1.5 deg and 12.5 cm once settled (no finite error on 3 of them)"
    assert words in some.verdict()
    none = changed(given, TUNED, rms_attitude=np.full(given.scenarios, np.nan))
    where = f"On {given.scenarios} unseen scenarios"
    assert none.verdict() == f"{where} the filter has no finite error."


def test_the_clairvoyant_is_below_the_costs():
    given = made_up((TUNED, CONSTANT))
    assert "clairvoyant" not in given.table()
    known = replace(given, clairvoyant=np.full(given.scenarios, 1.25))
    costs, behaviour = known.tables()
    assert [row[0] for row in costs[1:]] == [TUNED, CONSTANT, CLAIRVOYANT]
    assert costs[-1][1:2] == ["1.25"]
    assert [row[0] for row in behaviour[1:]] == [TUNED, CONSTANT], "nothing else of it is stored"
    assert from_json(Evaluation, to_json(known, SCHEMA), SCHEMA, FILE).costs[CLAIRVOYANT][0] == 1.25


def test_a_difference_that_may_be_chance_is_called_so():
    given = made_up((TUNED, CONSTANT))
    noise = np.resize([1.0, -1.0], given.scenarios)
    own = given.contenders[TUNED].metrics.cost
    given = changed(given, CONSTANT, cost=own - 0.01 + noise)
    words = r"no filter is surely better .* 0.01 points of cost less \(-"
    assert re.search(words, given.verdict())
    assert given.better == {}


def test_what_cannot_be_compared_is_told():
    given = changed(made_up((TUNED, CONSTANT)), TUNED, cost=np.full(40, np.inf))
    assert_states(given.verdict(), "cannot be compared", "best constant gains", "infinite costs")
    assert given.better == {}
