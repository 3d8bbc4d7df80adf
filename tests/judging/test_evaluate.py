"""Baselines, comparison and `evaluate`, on real runs of a tiny size."""

import dataclasses
import math
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders import quietly
from experiments import tiny

import posegsa
from posegsa.config import ObjectiveConfig, override
from posegsa.evaluating import evaluate
from posegsa.judging import baselines
from posegsa.judging import evaluation as comparison
from posegsa.judging.baselines import baselines as find_baselines
from posegsa.judging.baselines import best_constant
from posegsa.judging.evaluation import (
    CONSTANT,
    ORACLE,
    RANDOM,
    SMOOTH,
    TUNED,
    Evaluation,
    interval,
)
from posegsa.model.schedules import ConstantGain, KnotGain, ScheduleInputs, SmoothGain
from posegsa.optimisers import GSA, box, minimise
from posegsa.saving.records import from_json, to_json
from posegsa.saving.run import SCHEMA
from posegsa.search.build import scenario_batch
from posegsa.search.keys import held_out_keys, training_keys
from posegsa.search.population import costs_by_scenario

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


FILE = Path("evaluation.json")


@pytest.fixture(scope="module")
def evaluated():
    """A tiny run, evaluated against every baseline; the oracle's descent is cut short.

    As many scenarios as `tune` looks at, and `test_the_oracle_improves_on_its_starts`: what has
    one shape is compiled once.
    """
    patch = pytest.MonkeyPatch()
    patch.setattr(baselines, "ORACLE_STEPS", 12)
    patch.setattr(baselines, "KNOTS", 6)
    patch.setattr(baselines, "ORACLE_SCENARIOS", 2)
    told: list[str] = []
    tuned = posegsa.tune(tiny())
    yield tuned, evaluate(tuned, scenarios=5, progress=told.append), told
    patch.undo()


@pytest.fixture(scope="module")
def training():
    experiment = tiny()
    return scenario_batch(
        experiment,
        quietly(experiment),
        training_keys(experiment.run.seed, experiment.run.training_scenarios),
    )


def inputs(error, time=0.0) -> ScheduleInputs:
    return ScheduleInputs(jnp.float32(error), jnp.float32(0), jnp.float32(time), jnp.float32(1))


def test_every_baseline_is_judged_on_the_same_scenarios(evaluated):
    _, result, told = evaluated
    assert list(result.evaluation.contenders) == [TUNED, CONSTANT, RANDOM, SMOOTH, ORACLE]
    assert told[0] == f"searching: {ORACLE}", "the oracle is fixed before anything is compared"
    assert told[-5:] == [f"judging: {name}" for name in result.evaluation.contenders]
    starts = [c.metrics.initial_angle for c in result.evaluation.contenders.values()]
    assert all((s == starts[0]).all() for s in starts)
    assert all(len(s) == 5 for s in starts)


def test_the_first_held_out_scenarios_are_those_that_tune_judged_on(evaluated):
    tuned, result, _ = evaluated
    few = tuned.evaluation.contenders[TUNED].metrics.cost
    many = result.evaluation.contenders[TUNED].metrics.cost
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
    assert len(own | other | training) == 2002


def test_differences_are_paired(evaluated):
    evaluation = evaluated[1].evaluation
    tuned, constant = (evaluation.contenders[n].metrics.cost for n in (TUNED, CONSTANT))
    found = evaluation.difference(CONSTANT)
    assert found.mean == pytest.approx(np.mean(tuned - constant))
    assert found.low < found.mean < found.high
    half = 1.96 * np.std(tuned - constant, ddof=1) / math.sqrt(5)
    assert found.high - found.mean == pytest.approx(half)


def test_the_gap_closed_is_between_constant_and_oracle(evaluated):
    evaluation = evaluated[1].evaluation
    tuned, constant, best = (evaluation.cost(n).mean for n in (TUNED, CONSTANT, ORACLE))
    closed = evaluation.gap_closed()
    if constant > best:
        assert closed == pytest.approx((constant - tuned) / (constant - best))
    else:
        assert closed is None
    assert evaluated[0].evaluation.gap_closed() is None, "tune does not run the oracle"


def test_json_gives_everything_back(evaluated):
    evaluation = evaluated[1].evaluation
    again = from_json(Evaluation, to_json(evaluation, SCHEMA), SCHEMA, FILE)
    assert again.table() == evaluation.table()
    assert list(again.contenders) == list(evaluation.contenders)
    for name, contender in evaluation.contenders.items():
        for a, b in zip(contender.metrics, again.contenders[name].metrics, strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(contender.bands, again.contenders[name].bands, strict=True):
            np.testing.assert_array_equal(a, b)
        assert again.contenders[name].schedule == contender.schedule


def test_a_diverged_contender_is_told_and_not_averaged_away(evaluated):
    evaluation = evaluated[1].evaluation
    first = evaluation.contenders[CONSTANT]
    cost = first.metrics.cost.copy()
    cost[3] = np.inf
    diverged = first.metrics.diverged.copy()
    diverged[3] = True
    metrics = first.metrics._replace(cost=cost, diverged=diverged)
    contenders = evaluation.contenders | {CONSTANT: first._replace(metrics=metrics)}
    bad = dataclasses.replace(evaluation, contenders=contenders)
    assert bad.cost(CONSTANT).mean == math.inf
    assert math.isnan(bad.difference(CONSTANT).low)
    assert bad.gap_closed() is None
    assert "20.0" in bad.table()
    again = from_json(Evaluation, to_json(bad, SCHEMA), SCHEMA, FILE)
    assert again.cost(CONSTANT).mean == math.inf


def test_interval_of_known_values():
    found = interval(np.array([1.0, 2.0, 3.0, 4.0]))
    assert found.mean == 2.5
    assert found.high - found.mean == pytest.approx(1.96 * np.std([1, 2, 3, 4], ddof=1) / 2)
    assert math.isnan(interval(np.array([1.0])).low)


def test_the_grids_constant_is_as_good_as_a_search_finds(training):
    def mean_costs(gains):
        return jnp.mean(costs_by_scenario(ConstantGain(gains[:, 0]), training), axis=0)

    gsa, allowed = GSA(agents=20, iterations=20), box([1.0], [101.0])
    found = minimise(mean_costs, allowed, gsa, jax.random.key(0)).best_position
    grid = best_constant(training, (0.0, 100.0), ObjectiveConfig())
    costs = [
        float(jnp.mean(costs_by_scenario(ConstantGain(k), training)))
        for k in (found, grid.gain[None])
    ]
    assert costs[0] == pytest.approx(costs[1], rel=2e-3)


def test_the_smooth_schedule_is_half_way_at_half():
    schedule = SmoothGain(jnp.float32(2), jnp.float32(50), jnp.float32(0.3))
    assert float(schedule(inputs(0.0))) == 2
    assert float(schedule(inputs(0.3))) == pytest.approx(26)
    assert float(schedule(inputs(1.0))) < 50


def test_the_knot_schedule_passes_its_knots_and_holds_its_ends():
    knots = KnotGain(jnp.float32([0, 1, 3]), jnp.log(jnp.float32([100, 10, 1])))
    for time, gain in ((0, 100), (1, 10), (2, math.sqrt(10)), (3, 1), (9, 1)):
        assert float(knots(inputs(0.1, time))) == pytest.approx(gain, rel=1e-5)


def test_the_oracle_improves_on_its_starts(training, monkeypatch):
    monkeypatch.setattr(baselines, "ORACLE_STEPS", 25)
    monkeypatch.setattr(baselines, "KNOTS", 6)
    knots, how = baselines.open_loop(training)
    starts = ConstantGain(jnp.float32(baselines.ORACLE_STARTS))
    cost = how["cost_fitted"]
    assert cost < float(jnp.min(jnp.mean(costs_by_scenario(starts, training), axis=0)))
    again = costs_by_scenario(jax.tree.map(lambda a: a[None], knots), training)
    # The descent's program is another one: rounding only, since the gain limit is on.
    assert float(jnp.mean(again)) == pytest.approx(cost, rel=1e-4)


def test_the_oracles_knots_cover_the_run(monkeypatch):
    monkeypatch.setattr(baselines, "KNOTS", 24)
    knots = baselines.oracle_knots(14.99)
    assert len(knots) == 24
    assert (np.diff(knots) > 0).all()
    assert knots[0] == 0
    assert knots[-1] == 14.99
    assert (knots > 4).sum() >= 10, "most of the cost is there"


def test_a_percentile_does_not_hide_divergence(evaluated):
    evaluation = evaluated[1].evaluation
    first = evaluation.contenders[CONSTANT]
    cost = first.metrics.cost.copy()
    cost[3] = np.inf
    contenders = evaluation.contenders | {
        CONSTANT: first._replace(metrics=first.metrics._replace(cost=cost))
    }
    assert dataclasses.replace(evaluation, contenders=contenders).summary(CONSTANT).p95 == math.inf


def test_too_few_scenarios_are_refused(evaluated):
    with pytest.raises(ValueError, match="scenarios = 1"):
        evaluate(evaluated[0], scenarios=1)


def test_the_table_holds_every_contender(evaluated):
    text = evaluated[1].evaluation.table()
    for name in (TUNED, CONSTANT, RANDOM, SMOOTH, ORACLE):
        assert text.count(name) == 2
    assert "5 held-out scenarios" in text
    assert comparison.TUNED in text


@pytest.mark.parametrize(("name", "library"), [("cma_es", "evosax"), ("pycma", "cma")])
def test_the_random_baseline_needs_no_library_of_the_runs_own_optimiser(
    evaluated, monkeypatch, name, library
):
    tuned, judged, _ = evaluated
    for module in [m for m in sys.modules if m.split(".")[0] == library]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, library, None)
    experiment = override(tuned.experiment, [f"search.optimiser={name}"])
    result = dataclasses.replace(tuned, experiment=experiment)
    with jax.enable_x64(experiment.run.dtype == "float64"):
        _, found = find_baselines(result, quietly(experiment))[RANDOM]()
    assert found["k"] == judged.evaluation.contenders[RANDOM].schedule["k"]
