"""Filters that are written by components: many agents at once are each by itself."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import LEARNT, lasting, paper, posed

from posegsa import config
from posegsa.config.shipped import find
from posegsa.filters.attitude import AttitudeFilter, AttitudeNumbers
from posegsa.filters.base import Record, Samples, Sensors, elementwise
from posegsa.filters.calls import started, stepped
from posegsa.filters.observer import Observer
from posegsa.judging.metrics import cost_parts, error_tracks
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.sample import prepare
from posegsa.model.schedules import (
    ConstantGain,
    Gains,
    KnotGain,
    ScheduleInputs,
    SearchedRulesGain,
    SwitchGain,
)
from posegsa.model.se3 import move, scale
from posegsa.model.vectors import VectorSettings
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import scenario_keys
from posegsa.search.population import agent_costs
from posegsa.search.problem import tuning_problem

pytestmark = pytest.mark.usefixtures("x64")
AGENTS = 5
ALL_OF_KALMAN = ("filter.unknown=fuzzy", "filter.angular_lead=0.5", "filter.noise_adaptation=50.0")


def of_kalman(*settings: str) -> config.Experiment:
    """`disturbed`, with belief and whatever else a Kalman filter may have."""
    scenarios = ("run.training_scenarios=1", "run.held_out_scenarios=1", "run.dtype=float64")
    shipped = config.load(find("disturbed"))
    return config.override(shipped, [*scenarios, *lasting(1.5), *settings])


@pytest.mark.parametrize(
    "experiment",
    [
        pytest.param(of_kalman(*ALL_OF_KALMAN), id="Kalman"),
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


def shared_times() -> KnotGain:
    return dataclasses.replace(random_knots(), time=jnp.asarray([0.0, 3.0, 5.0, 9.0]))


def random_switch() -> SwitchGain:
    return SwitchGain(*jnp.asarray(np.random.default_rng(5).uniform(1, 9, (4, AGENTS))))


def random_rules() -> SearchedRulesGain:
    terms = np.sort(np.random.default_rng(1).uniform(0, 1, (AGENTS, 5, 3)), axis=-1)
    terms = jnp.asarray(np.sort(terms, axis=1))
    rules = ((0,) * 5,) * 5
    targets = jnp.asarray(np.random.default_rng(2).integers(0, 5, (AGENTS, 5, 5)))
    return SearchedRulesGain(FuzzyController(terms, 100 * terms, rules, (0.0, 100.0)), targets)


@pytest.mark.parametrize(
    "made",
    [random_knots, shared_times, random_switch, random_rules],
    ids=["knots", "shared times", "switch", "rules"],
)
def test_a_schedule_of_many_agents_is_each_agents(made: Callable[[], Any]) -> None:
    schedule = made()
    error, rate, last = jnp.asarray(np.random.default_rng(6).uniform(0, 1, (3, AGENTS)))

    def gains(one: Any, *inputs: Any) -> Any:
        given = ScheduleInputs(*inputs[:2], time=jnp.asarray(4.0), last=inputs[2])
        return one.prepare()(given), jnp.broadcast_to(one.initial_gain(), inputs[0].shape)

    of_each = jax.tree.map(lambda a: 0 if np.shape(a)[0] == AGENTS else None, schedule)
    one_by_one = jax.vmap(gains, in_axes=(of_each, 0, 0, 0))
    together, apart = (run(schedule, error, rate, last) for run in (gains, one_by_one))
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
    run = jax.jit(lambda a, b: agent_costs(a, b))
    limits = Candidate(None, (jnp.asarray([0.01, 0.01]),), ("filter.gain_limit",))
    in_filter = run(limits, batch._replace(filter=filter))
    gains = Candidate(Deciding(jnp.asarray([9.0, 9.0])), limits.values, limits.keys)
    np.testing.assert_allclose(in_filter, run(gains, batch), rtol=1e-12)


def test_a_subclass_says_itself_that_it_is_elementwise() -> None:
    class Own(Observer):
        pass

    assert elementwise(Observer(ConstantGain(jnp.asarray(9.0))))
    assert not elementwise(Own(ConstantGain(jnp.asarray(9.0))))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Constant:
    """A user's filter by components, whose state, record and estimate hold constants."""

    gain: Any
    elementwise: ClassVar[bool] = True

    def with_values(self, values: Any) -> Self:
        return dataclasses.replace(self, **values)

    def prepare(self, measurements: Measurements) -> Any:
        return prepare(measurements, VectorSettings(each_agent=True))

    def start(self, initial: Any, sensors: Sensors) -> Any:
        return 0.0, initial

    def ready(self) -> Self:
        return self

    def step(self, state: Any, now: Samples) -> Any:
        dt, (_, estimate) = now.sample.time_step, state
        omega = scale(dt * self.gain, now.sample.angular_velocity)
        attitude, place = move(estimate.attitude, estimate.place, omega, (0.0 * dt,) * 3)
        after = estimate._replace(attitude=attitude, place=place)
        return (1.0, after), Record(gain=self.gain, gain_used=2.0)

    def estimate(self, state: Any) -> FilterState:
        return state[1]._replace(bias_linear=(0.0, 1.0, 2.0))


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_constants_of_a_filter_are_the_same_in_all_simulations() -> None:
    agents = Candidate(None, (jnp.asarray([0.5, 1.0, 2.0]),), ("filter.gain",))
    filter = Constant(jnp.asarray(1.0))
    batch = scenario_batch(paper(*lasting(1.0)), scenario_keys(jax.random.key(0), 2), filter)
    costs = np.asarray(jax.jit(lambda a, b: agent_costs(a, b))(agents, batch))
    for i in range(3):
        tracks = error_tracks(jax.tree.map(lambda a, i=i: a[i], agents), batch)
        np.testing.assert_allclose(sum(cost_parts(tracks, batch)), costs[:, i], rtol=1e-9)
        np.testing.assert_array_equal(tracks.gain, 2.0)
        np.testing.assert_array_equal(tracks.bias[:, 3:], [[0.0, 1.0, 2.0]] * 2)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KnownStart(Constant):
    """One whose state is the same in all simulations before the first sample."""

    elementwise: ClassVar[bool] = True

    def start(self, initial: Any, sensors: Sensors) -> Any:
        zeros = jax.tree.map(lambda a: jnp.zeros((), a.dtype), initial)
        return 0.0, zeros._replace(attitude=(1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("scenarios", [1, 12])  # one by one, and several in a piece
@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_a_start_may_be_the_same_in_all_simulations(scenarios: int) -> None:
    agents = Candidate(None, (jnp.asarray([0.5, 1.0, 2.0]),), ("filter.gain",))
    filter, keys = KnownStart(jnp.asarray(1.0)), scenario_keys(jax.random.key(0), scenarios)
    batch = scenario_batch(paper(*lasting(1.0)), keys, filter)
    costs = np.asarray(jax.jit(lambda a, b: agent_costs(a, b))(agents, batch))
    for i in range(3):
        tracks = error_tracks(jax.tree.map(lambda a, i=i: a[i], agents), batch)
        np.testing.assert_allclose(sum(cost_parts(tracks, batch)), costs[:, i], rtol=1e-9)


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

    def run(numbers: Any, shape: tuple[int, ...]) -> Any:
        filter = AttitudeFilter(AttitudeNumbers(*numbers))
        start = initial_state(np.eye(3), np.zeros(3))
        start = jax.tree.map(lambda a: jnp.broadcast_to(a, shape), start)
        state = started(filter, start, Sensors(2, 0))

        def body(state: Any, now: Samples) -> Any:
            after, _ = stepped(filter.ready(), state, now, shape)
            return after, after.estimate

        return jax.lax.scan(body, state, Samples(time, samples, None))

    together = jax.jit(lambda n: run(n, (AGENTS,)))(numbers)
    each = jax.jit(jax.vmap(lambda n: run(n, ()), in_axes=1, out_axes=-1))(numbers)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(each), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
