"""Filters that are written by components: many agents at once are each by itself."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import LEARNT, lasting, paper, posed

from posegsa import config
from posegsa.config.shipped import find
from posegsa.filters.attitude import AttitudeFilter, AttitudeNumbers
from posegsa.filters.base import Samples, Sensors, elementwise
from posegsa.filters.calls import started, stepped
from posegsa.model.estimate import initial_state
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.schedules import (
    ConstantGain,
    Gains,
    KnotGain,
    ScheduleInputs,
    SearchedRulesGain,
    SwitchGain,
)
from posegsa.search.candidates import Candidate
from posegsa.search.population import agent_costs
from posegsa.search.problem import tuning_problem

pytestmark = pytest.mark.usefixtures("x64")
AGENTS = 5


def of_kalman(*settings: str) -> config.Experiment:
    """`disturbed`, with belief and whatever else a Kalman filter may have."""
    scenarios = ("run.training_scenarios=1", "run.held_out_scenarios=1", "run.dtype=float64")
    shipped = config.load(find("disturbed"))
    return config.override(shipped, [*scenarios, *lasting(1.5), *settings])


@pytest.mark.parametrize(
    "experiment",
    [
        pytest.param(of_kalman("filter.unknown=fuzzy", "filter.angular_lead=0.5"), id="Kalman"),
        pytest.param(paper(*lasting(5.0), *LEARNT, "filter.belief=ramp"), id="observer"),
        pytest.param(paper(*lasting(5.0), "fuzzy.centroid=sampled"), id="sampled centroid"),
    ],
)
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_agents_together_cost_what_they_cost_by_themselves(
    experiment: config.Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = tuning_problem(experiment)
    batch, box = problem.training.select(slice(1)), problem.space.box
    shares = np.random.default_rng(0).uniform(size=(AGENTS, box.lower.size))
    lower, upper = np.asarray(box.lower), np.asarray(box.upper)
    agents = jax.vmap(problem.space.candidate)(jnp.asarray(lower + (upper - lower) * shares))
    costs = []
    for together in (True, False):
        monkeypatch.setattr(type(batch.filter), "elementwise", together)
        assert elementwise(batch.filter) == together
        costs.append(np.asarray(jax.jit(lambda a, b: agent_costs(a, b))(agents, batch)))
    np.testing.assert_allclose(*costs, rtol=1e-9)
    assert np.ptp(costs[0]) > 0.01 * np.mean(costs[0])


def random_knots() -> KnotGain:
    draw = np.random.default_rng(3)
    time = jnp.asarray(np.sort(draw.uniform(0, 9, (AGENTS, 4))))
    return KnotGain(time, jnp.asarray(draw.normal(size=(AGENTS, 4))))


def random_switch() -> SwitchGain:
    return SwitchGain(*jnp.asarray(np.random.default_rng(5).uniform(1, 9, (4, AGENTS))))


def random_rules() -> SearchedRulesGain:
    terms = np.sort(np.random.default_rng(1).uniform(0, 1, (AGENTS, 5, 3)), axis=-1)
    terms = jnp.asarray(np.sort(terms, axis=1))
    rules = ((0,) * 5,) * 5
    targets = jnp.asarray(np.random.default_rng(2).integers(0, 5, (AGENTS, 5, 5)))
    return SearchedRulesGain(FuzzyController(terms, 100 * terms, rules, (0.0, 100.0)), targets)


@pytest.mark.parametrize(
    "made", [random_knots, random_switch, random_rules], ids=["knots", "switch", "rules"]
)
def test_a_schedule_of_many_agents_is_each_agents(made: Callable[[], Any]) -> None:
    schedule = made()
    error, rate, last = jnp.asarray(np.random.default_rng(6).uniform(0, 1, (3, AGENTS)))

    def gains(one: Any, *inputs: Any) -> Any:
        given = ScheduleInputs(*inputs[:2], time=jnp.asarray(4.0), last=inputs[2])
        return one.prepare()(given), jnp.broadcast_to(one.initial_gain(), inputs[0].shape)

    together, apart = (run(schedule, error, rate, last) for run in (gains, jax.vmap(gains)))
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(apart), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Deciding(ConstantGain):
    """A user's schedule that needs scalars."""

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        return Gains(jax.lax.cond(inputs.error > 0.5, lambda: 2 * self.gain, lambda: self.gain))


def test_a_schedule_that_needs_scalars_gets_them() -> None:
    batch = posed(paper(*lasting(1.5)))
    filter = dataclasses.replace(batch.filter, schedule=Deciding(jnp.asarray(9.0)))
    assert elementwise(batch.filter)
    assert not elementwise(filter)
    lengths = Candidate(None, (jnp.asarray([1.0, 2.0]),), ("filter.gain_limit",))
    costs = jax.jit(lambda a, b: agent_costs(a, b))(lengths, batch._replace(filter=filter))
    assert costs.shape == (1, 2)
    assert np.isfinite(costs).all()


def test_attitude_filters_together_are_each_by_itself() -> None:
    """One step after another: before and after the first field, at rest, and after a pause."""
    names = AttitudeNumbers._fields
    draw = np.random.default_rng(7)
    usual = np.array([getattr(config.AttitudeConfig(), name) for name in names])
    numbers = jnp.asarray(usual[:, None] * draw.uniform(0.5, 2, (len(names), AGENTS)))
    N = 40
    measured = Measurements.from_arrays(
        time_step=np.where(np.arange(N) == 30, 20.0, 0.01),
        angular_velocity=np.where(np.arange(N)[:, None] < 20, 0.5, 0.0) * draw.normal(size=(N, 3)),
        velocity=np.zeros((N, 3)),
        vectors=np.array([[0, 0, 9.81], [0.2, 0.4, -0.4]]) + 0.01 * draw.normal(size=(N, 2, 3)),
        vector_references=np.array([[0, 0, 9.81], [0.0, 0.5, -0.4]]),
        vector_weights=np.stack([np.ones(N), np.arange(N) % 3 == 1], axis=1),
        dtype=np.float64,
    )
    samples = AttitudeFilter(AttitudeNumbers(*numbers)).prepare(measured)
    time = jnp.zeros(N)

    def run(numbers: Any, like: Any, at_once: bool) -> Any:
        filter = AttitudeFilter(AttitudeNumbers(*numbers))
        start = initial_state(np.eye(3), np.zeros(3))
        start = jax.tree.map(lambda a: jnp.broadcast_to(a, like.shape), start)
        state = started(filter, start, Sensors(2, 0))

        def body(state: Any, now: Samples) -> Any:
            after, _ = stepped(filter.ready(), state, now, at_once)
            return after, after.estimate

        return jax.lax.scan(body, state, Samples(time, samples, None))

    together = jax.jit(lambda n: run(n, n[0], True))(numbers)
    each = jax.jit(jax.vmap(lambda n: run(n, n[0], False), in_axes=1, out_axes=-1))(numbers)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(each), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
