"""Trust checks: a chaotic or lost result is marked, a sound one not, rules are counted right."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.experiments import tiny
from helpers.results import changed, evaluation, result, trajectory, trust

import posegsa
from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.trust import rule_weights, uncovered
from posegsa.model.fuzzy import FuzzyController

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


COSTS = ("cost_float32", "cost_float64", "cost_perturbed")


@pytest.fixture(scope="module")
def sound():
    return posegsa.tune(tiny())


def test_with_the_gain_limit_a_result_is_not_sensitive(sound):
    trust = sound.on_scenarios.trust
    assert not trust.sensitive
    assert trust.cost_float32 == pytest.approx(sound.best_cost, rel=1e-4)
    assert trust.cost_float64 == pytest.approx(trust.cost_float32, rel=1e-3)
    assert trust.cost_perturbed != trust.cost_float32, "the start was changed"
    assert trust.cost_perturbed == pytest.approx(trust.cost_float32, rel=1e-3)
    assert not any("SENSITIVE" in w for w in sound.warnings())


def test_without_it_a_filter_that_is_lost_is_marked():
    # With these weights every gain of the paper's boxes is far above the stable ones. The program
    # is the one of the sound result.
    settings = ["filter.gain_limit=off"]
    settings += [f"scenario.{one}.weight=30.0" for one in ("vectors.0", "vectors.1", "landmarks.0")]
    wild = posegsa.tune(tiny(*settings))
    assert wild.on_scenarios.trust.sensitive
    assert not wild.on_scenarios.trust.chaotic, "no cost is finite"
    words = "no finite cost on 3 of 3 training scenarios and 3 of 3 held-out scenarios"
    assert words in " ".join(wild.summary().split())
    assert "errs by" not in wild.summary()


def test_the_uncovered_share_is_counted(sound):
    assert uncovered(sound.controller) == 0, "coverage repair leaves no gap"
    gap = np.array(sound.controller.input_terms)
    gap[:, 0], gap[:, 1], gap[:, 2] = gap[:, 1], gap[:, 1], gap[:, 1]
    gap[4] = (0.5, 1.0, 1.0)  # only errors and rates over 0.5 have a term
    gap[:4] = 0.0
    controller = FuzzyController(
        jnp.asarray(gap),
        sound.controller.output_terms,
        sound.controller.rules,
        sound.controller.output_range,
    )
    # A term fires on half of each axis, and at 0 itself (1 of 201 points).
    assert uncovered(controller) == pytest.approx(0.75, abs=0.01)


def test_rule_weights_are_mean_firing_strengths(sound):
    rng = np.random.default_rng(0)
    error, rate = rng.uniform(size=(2, 200))
    terms = np.asarray(sound.controller.input_terms, np.float64)
    expected = np.zeros((5, 5))
    for e, r in zip(error, rate, strict=True):
        for i in range(5):
            for j in range(5):
                expected[i, j] += min(
                    reference.triangle(r, *terms[i]), reference.triangle(e, *terms[j])
                )
    np.testing.assert_allclose(
        rule_weights(sound.controller, error, rate), expected / 200, atol=1e-5
    )


def test_an_estimate_that_is_not_finite_is_named_with_where_and_since_when() -> None:
    lost = trajectory()
    lost.attitude_error[125:] = np.nan
    costs = {TUNED: np.array([np.inf, 41.5]), CONSTANT: np.array([44.0, 46.0])}
    unseen = np.full(40, 30.0)
    unseen[:8] = np.inf
    given = result(
        trust=trust(sensitive=True, **dict.fromkeys(COSTS, np.inf)),
        training=costs,
        evaluation=changed(evaluation(), TUNED, cost=unseen),
        trajectory=lost,
    )
    first = given.warnings()[0]
    assert "no finite cost on 1 of 2 training scenarios and 8 of 40 held-out scenarios" in first
    assert "its estimate is not finite from 1.25 s on: do not trust this filter" in first
    assert not any("SENSITIVE" in words for words in given.warnings())
    some = dataclasses.replace(given.on_scenarios, trust=trust(sensitive=True, cost_float64=np.inf))
    assert [words.partition(":")[0] for words in some.warnings()[:2]] == ["NOT FINITE", "SENSITIVE"]
    assert "On one unseen scenario the estimate is not finite from 1.25 s on." in given.summary()
    assert "NOT FINITE" not in " ".join(result().warnings())


@pytest.mark.parametrize(("inside", "told"), [(0.55, True), (0.94, False), (np.nan, False)])
def test_a_covariance_that_is_too_small_is_told(inside, told) -> None:
    share = np.full(40, inside)
    given = result(evaluation=changed(evaluation(), TUNED, nees_inside=share))
    sentence = "The tuned filter is too sure: once settled, the true pose is inside its 95 % bound"
    assert (f"{sentence} at 55 % of the samples. Do not" in given.summary()) == told
    other = given.on_scenarios.beside
    both = result(
        evaluation=changed(given.on_scenarios.evaluation, other, nees_inside=0.4 + 0 * share)
    )
    assert (f"55 % of the samples ({other}: 40 %). Do not" in both.summary()) == told


def test_warnings_name_what_went_wrong(sound):
    judged = sound.on_scenarios
    gaps = dataclasses.replace(judged.trust, uncovered=0.125)
    found = dataclasses.replace(
        sound,
        on_scenarios=dataclasses.replace(judged, trust=gaps),
        search=dataclasses.replace(sound.search, non_finite=3),
    )
    text = " ".join(found.warnings())
    assert "12.5 %" in text
    assert "3 agents" in text
