"""Any filter's step as C: its functions are traced as a whole, and its state becomes a struct.

The struct has the estimate under the same names for every filter. The other numbers of the state
follow, named after their paths in the state. Numbers that the state and the estimate share are
stored once; numbers that the estimate computes from the state are computed after each step.
"""

import math
import re
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.arguments import fitting, refuse
from posegsa.export.c_step import (
    Piece,
    References,
    directions_of,
    estimate_in_c,
    known_places,
    numbered,
    one_measurement,
    rotation_matrix,
    sample_of,
    shown_pose,
    values_of,
    vec3,
)
from posegsa.export.c_text import KEYWORDS, comment, sensors_in_words, wrapped
from posegsa.export.scalar_loops import written_in_loops
from posegsa.export.scalar_trace import Known, passed_on
from posegsa.filters.attitude import REST_TIME, AttitudeFilter
from posegsa.filters.base import Filter, Samples, Sensors
from posegsa.filters.calls import estimated, started, stepped
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.filters.observer import Observer, ObserverGains
from posegsa.model.elementwise import choose
from posegsa.model.estimate import FilterState
from posegsa.model.sample import Sample
from posegsa.model.schedules import Gains, GainSchedule, KnotGain, ScheduleInputs
from posegsa.model.vectors import VectorSamples

_ESTIMATE = ("attitude", "position", "bias_angular", "bias_linear", "vector_bias", "turning")
"""Fields of the struct that every state may have."""
_NO_FIELD: Any = ("", "", "")
_TAKEN = {*_ESTIMATE, "time", *KEYWORDS}
_KNOWN_FIELDS = {
    KalmanFilter: {
        "covariance": "upper triangle by rows: attitude, position, biases [their units squared]"
    },
    AttitudeFilter: {
        "covariance": "upper triangle by rows: attitude error about east, north and up [rad^2], "
        "bias, velocity; [0] + [8] is the inclination's variance, [15] the heading's",
        "forget": "1 or 2 where the next step forgets the covariances, but not the variances",
        "velocity": "to the east and north [m/s]",
        "field": "mean magnetic field to the east, north and up",
        "iron": "mean field that turns with the body, body frame",
        "field_belief": "how far the field is believed, 0 to 1",
        "still_time": f"how long it has been still [s]; from {REST_TIME:g} s on it is at rest",
    },
}
"""What fields hold, by filter."""


@dataclass(frozen=True)
class _Field:
    """A field of the struct that is not part of the estimate: a number or an array."""

    name: str
    about: str
    size: int
    """Length of an array; 0 for a single number."""

    @property
    def declared(self) -> str:
        return f"{self.name}[{self.size}]" if self.size else self.name

    @property
    def leaves(self) -> list[str]:
        """Its numbers, in C."""
        return [f"{self.name}[{i}]" for i in range(self.size)] if self.size else [self.name]


def any_filter(
    filter: Filter, vectors: ArrayLike | None, landmarks: ArrayLike | None
) -> dict[str, Any]:
    """The values for the template `any_filter.h`.

    Args:
        filter: Any filter except an `Observer` without belief.
        vectors: (n, 3) v_i^I, inertial frame, in the unit of their sensor.
        landmarks: (m, 3) p_i, inertial frame [m].

    Raises:
        ArgumentError: The filter can't be written as scalar arithmetic.
        MeasurementError: Vectors or landmarks are not finite, or a vector is 0.
    """
    if isinstance(filter, KalmanFilter | Observer):
        filter = _with_written_schedules(filter)
    v, p = known_places(vectors, landmarks)
    with jax.enable_x64(True):
        known, crossed = _references(jax.tree.map(_wide, filter), v, p)
    step = _Step(filter, known, crossed)
    states, start = 0, {}
    if isinstance(filter, KalmanFilter):
        states = 12 + 3 * step.learnt
        start = {
            "degrees": f"{math.degrees(float(filter.noise.initial_attitude)):.3g}",
            "metres": f"{float(filter.noise.initial_position):.3g}",
        }
    return values_of(step.pieces, step.numbers, known) | {
        "title": "an attitude filter" if step.alone else "a pose filter",
        "attitude_only": step.alone,
        "may_be_set": "" if step.alone else ", and set",
        "purpose": comment(_purpose(filter, known, states)),
        "learns": step.learnt > 0,
        "turning": step.turning,
        "states": states,
        "start": start,
        "memory": step.memory,
        "uses_reach": any(piece.code.mentions("farthest") for piece in step.pieces.values()),
    }


class _Step:
    """A filter's functions as C, and the struct of its state."""

    def __init__(self, filter: Filter, known: References, crossed: bool) -> None:
        self._vectors = len(known.vectors)
        self._sensors = Sensors(len(known.vectors), len(known.landmarks))
        self._known = known
        self._settings = filter.settings if isinstance(filter, Observer) else None
        self._known_fields = _KNOWN_FIELDS.get(type(filter), {})
        self.alone = isinstance(filter, AttitudeFilter)
        """Whether there is no position: its fields are left out."""
        leaves, self._filter_structure = jax.tree.flatten(filter)
        self.numbers = _named_numbers(filter)
        assert len(leaves) == len(self.numbers)
        self._given = [number for number, _ in self.numbers]
        with jax.enable_x64(True), fitting("filter_to_c: filter"):
            wide = jax.tree.map(_wide, filter)
            zero = jnp.zeros(())
            initial = _initial(zero, zero + 1)
            state = jax.eval_shape(lambda start: started(wide, start, self._sensors), initial)
            self._check_state(state)
            estimate = jax.eval_shape(lambda s: estimated(wide.ready(), s), state)
            self._check_estimate(estimate)
            sample = wide.prepare(one_measurement(known.vectors, known.landmarks))
            now = Samples(zero, sample, None)
            jax.eval_shape(lambda s, n: stepped(wide.ready(), s, n)[0], state, now)
        self.learnt = len(estimate.vector_biases)
        self.turning = len(estimate.turning) > 0
        self._structure = jax.tree.structure(state)
        names = estimate_in_c("->", self.learnt, self.turning)
        if self.alone:
            names = names._replace(place=_NO_FIELD, bias_linear=_NO_FIELD)
        leaves = jax.tree.leaves(names)
        self.memory, self._state, self._computed = self._laid_out(state, leaves)
        seen = sample_of(
            self._vectors,
            len(known.landmarks),
            crossed=crossed,
            velocity=(0.0, 0.0, 0.0) if self.alone else vec3("seen->velocity"),
            farthest="farthest",
        )
        self.pieces = self._written(_in_a_known_frame(seen, known) if self.alone else seen)

    def _check_state(self, state: Any) -> None:
        for path, leaf in jax.tree_util.tree_leaves_with_path(state):
            if leaf.shape or not jnp.issubdtype(leaf.dtype, jnp.floating):
                what = f"an array of shape {leaf.shape}" if leaf.shape else f"of type {leaf.dtype}"
                refuse(
                    f"filter: its state's {_words(path)} is {what}",
                    "real scalars (a counter must be real too), in tuples if there are several",
                )

    def _check_estimate(self, estimate: FilterState) -> None:
        count = len(estimate.vector_biases)
        if count not in (0, self._vectors):
            refuse(
                f"filter: its estimate has biases of {count} vectors",
                f"those of {self._vectors} vectors, or of none",
            )
        expected = estimate_in_c("", count, len(estimate.turning) > 0)
        if jax.tree.structure(estimate) != jax.tree.structure(expected):
            refuse("filter: its estimate has another number of components", "a FilterState")

    def _laid_out(
        self, state: Any, estimate: list[str]
    ) -> tuple[list[_Field], list[str], list[str | None]]:
        """Other fields than the estimate, and the text that each number of the state has in C.

        The third result holds the numbers of the estimate that are not in the state, None for
        others.
        """
        paths = [path for path, _ in jax.tree_util.tree_leaves_with_path(state)]
        own = [f"state_{i}" for i in range(len(paths))]
        shared = passed_on(self._estimate, (self._given, own))
        texts: dict[str, str] = {}
        computed: list[str | None] = list(estimate)
        for i, (leaf, name) in enumerate(zip(shared, estimate, strict=True)):
            if leaf in own and leaf not in texts:
                texts[leaf], computed[i] = name, None
        groups: dict[str, list[str]] = {}
        for leaf, path in zip(own, paths, strict=True):
            if leaf not in texts:
                groups.setdefault(_field_name(path), []).append(leaf)
        fields = []
        for name, leaves in groups.items():
            field = _Field(
                name=name,
                about=self._known_fields.get(name, "of the filter's own state"),
                size=len(leaves) if len(leaves) > 1 else 0,
            )
            fields.append(field)
            texts |= {leaf: f"->{text}" for leaf, text in zip(leaves, field.leaves, strict=True)}
        return fields, [texts[leaf] for leaf in own], computed

    def _estimate(self, given: Any, state: Any) -> Any:
        return self._ready(given).estimate(jax.tree.unflatten(self._structure, state))

    def _ready(self, given: Any) -> Any:
        return jax.tree.unflatten(self._filter_structure, given).ready()

    def _written(self, sample: Sample) -> dict[str, Piece]:
        """The C of start and step; each ends with what the estimate computes from the state."""

        def start(given: Any, attitude: Any, place: Any, zero: Any) -> Any:
            initial = _initial(zero, zero)._replace(attitude=attitude, place=place)
            filter = jax.tree.unflatten(self._filter_structure, given)
            state = filter.start(initial, self._sensors)
            return jax.tree.leaves(state), filter.ready().estimate(state)

        def advance(given: Any, leaves: Any, time: Any, sample: Any) -> Any:
            ready = self._ready(given)
            state = jax.tree.unflatten(self._structure, leaves)
            after, _ = ready.step(state, Samples(time, sample, None))
            return jax.tree.leaves(after), ready.estimate(after)

        before = [f"now{text}" if text else 0.0 for text in self._state]
        results = tuple(
            [f"next{text}" if text else None for text in texts]
            for texts in (self._state, self._computed)
        )
        attitude = numbered("now->attitude", 4)
        place = (0.0, 0.0, 0.0) if self.alone else vec3("now->position")
        opening = written_in_loops(start, (self._given, attitude, place, 0.0), results)
        given = (self._given, before, "now->time", sample)
        after = written_in_loops(advance, given, results)
        pieces = [
            Piece.of("start", "the state before the first sample", opening),
            Piece.of("advance", "the state at the next sample", after),
            rotation_matrix(),
        ]
        if self.alone:
            return {piece.name: piece for piece in pieces}
        first = shown_pose(sample, self._known, self._settings, attitude_only=False)
        return {piece.name: piece for piece in pieces} | first


def _in_a_known_frame(sample: Sample, known: References) -> Sample:
    """A sample whose references are numbers: the axes that follow from them are computed here."""
    assert isinstance(sample.vectors, VectorSamples)
    each = zip(sample.vectors.each, known.vectors.tolist(), strict=True)
    written = tuple(one._replace(known=tuple(row)) for one, row in each)
    return sample._replace(vectors=sample.vectors._replace(each=written))


def _with_written_schedules(filter: KalmanFilter | Observer) -> KalmanFilter | Observer:
    """The filter with schedules whose numbers are literals in the code."""
    schedules = filter.schedule
    assert isinstance(schedules, NoiseGains | ObserverGains)
    roles = {role: one for role, one in schedules._asdict().items() if one is not None}
    written = {role: _WrittenSchedule(one) for role, one in roles.items()}
    return replace(filter, schedule=schedules._replace(**written))


@jax.tree_util.register_static
class _WrittenSchedule:
    """A schedule of scalars, prepared in double precision; in C its numbers are literals."""

    def __init__(self, schedule: GainSchedule) -> None:
        if isinstance(schedule, KnotGain):
            self._initial = float(np.exp(np.float64(schedule.log_gain[0])))
            self._prepared = partial(_gain_at, _lines(schedule))
            return
        largest = float(np.finfo(np.float32).max)  # slopes of vertical edges are higher in float64
        with jax.enable_x64(True):
            prepared = jax.tree.map(
                lambda leaf: leaf if np.ndim(leaf) else min(float(leaf), largest),
                jax.tree.map(_wide, schedule).prepare(),
            )
            self._initial = float(schedule.initial_gain())
        self._prepared = prepared

    def initial_gain(self) -> Any:
        return self._initial

    def prepare(self) -> Any:
        return self._prepared


def _lines(schedule: KnotGain) -> list[tuple[float, float, float]]:
    """Start [s], log K there and slope of each piece of a `KnotGain`; the last is constant."""
    time, log_gain = (np.asarray(a, np.float64) for a in (schedule.time, schedule.log_gain))
    steps = np.diff(time)
    slopes = np.append(np.diff(log_gain) / np.where(steps > 0, steps, np.inf), 0.0)
    return list(zip(time.tolist(), log_gain.tolist(), slopes.tolist(), strict=True))


def _gain_at(lines: list[tuple[float, float, float]], inputs: ScheduleInputs) -> Gains:
    """`KnotGain` without its table, because scalar arithmetic can't look numbers up."""
    log_gain = jnp.full_like(inputs.time, lines[0][1])
    for begin, first, slope in lines:
        log_gain = choose(inputs.time < begin, log_gain, first + slope * (inputs.time - begin))
    return Gains(jnp.exp(log_gain))


def _wide(leaf: ArrayLike) -> Array:
    return jnp.asarray(np.asarray(leaf, np.float64))


def _initial(zero: Any, one: Any) -> FilterState:
    """An estimate at the origin."""
    zeros = (zero, zero, zero)
    return FilterState((one, zero, zero, zero), zeros, zeros, zeros)


def _words(path: Any) -> str:
    """A path in a pytree as text: `covariance[0][1]`."""
    return jax.tree_util.keystr(path).lstrip(".") or "only number"


def _field_name(path: Any) -> str:
    """The name of the field that a number of the state belongs to: its path up to an index."""
    text = jax.tree_util.keystr(path)
    head = re.match(r"(\.\w+)*", text)
    name = re.sub(r"\W+", "_", head.group() if head else "").strip("_") or "memory"
    return f"{name}_of_filter" if name in _TAKEN else name


def _named_numbers(filter: Filter) -> list[tuple[Known, str]]:
    """The filter's numbers with their names in C, and their comments."""
    found: list[tuple[Known, str]] = []
    taken: set[str] = set()
    kind = type(filter).__name__
    for path, leaf in jax.tree_util.tree_leaves_with_path(filter):
        value = np.asarray(leaf)
        if value.ndim or not jnp.issubdtype(value.dtype, jnp.floating):
            what = f"an array of shape {value.shape}" if value.ndim else f"of type {value.dtype}"
            refuse(
                f"filter: its {_words(path)} is {what}",
                "one made of real scalars (fields that are not numbers must be static)",
            )
        name = re.sub(r"\W+", "_", _words(path)).strip("_")
        while name in taken:
            name += "_"
        taken.add(name)
        found.append((Known(f"posegsa_filter_{name}", float(value)), f"{_words(path)} of {kind}"))
    return found


def _references(filter: Filter, v: np.ndarray, p: np.ndarray) -> tuple[References, bool]:
    """The references as a filter prepares them, and whether it uses a cross product of vectors."""
    rng = np.random.default_rng(0)
    exact = one_measurement(v, p)
    measured = exact._replace(
        time_step=jnp.asarray(0.5),
        **{
            name: jnp.asarray(rng.uniform(0.5, 1.5, np.shape(getattr(exact, name))))
            for name in (
                *("angular_velocity", "velocity", "vectors", "vector_weights"),
                *("landmarks", "landmark_weights"),
            )
        },
    )
    with fitting("filter_to_c: filter.prepare"):
        sample = filter.prepare(measured)
    allowed = (
        "what posegsa.model.sample.prepare makes with VectorSettings(each_agent=True); what is "
        "computed from it belongs in the step"
    )
    if not isinstance(sample, Sample):
        refuse(f"filter.prepare: it returns a {type(sample).__name__}", allowed)
    prepared = sample.vectors
    if not isinstance(prepared, VectorSamples):
        if len(v):
            refuse("filter.prepare: it sums up the vectors", allowed)
        nothing = jnp.zeros(())
        prepared = VectorSamples((), (nothing, nothing, nothing))
    directions = directions_of(prepared)
    of_measurement = (
        [sample.time_step, *sample.angular_velocity, *sample.velocity, sample.reach],
        [[*one.measured, *one.known, one.factor] for one in prepared.each],
        [[*one.body, *one.inertial, one.factor] for one in sample.landmarks],
    )
    m = jax.tree.map(np.asarray, measured)
    farthest = np.square(m.landmarks).sum(-1).max(initial=0.0)
    expected = (
        [m.time_step, *m.angular_velocity, *m.velocity, farthest],
        [[*m.vectors[i], *v[i], m.vector_weights[i]] for i in range(len(v))],
        [[*m.landmarks[i], *p[i], m.landmark_weights[i]] for i in range(len(p))],
    )
    same = jax.tree.structure(of_measurement) == jax.tree.structure(expected)
    pairs = zip(jax.tree.leaves(of_measurement), jax.tree.leaves(expected), strict=True)
    if not same or not all(np.allclose(a, b, rtol=1e-12, atol=0) for a, b in pairs):
        refuse("filter.prepare: it changes the measured values", allowed)
    return References(vectors=v, directions=directions, landmarks=p), bool(directions[-1].any())


def _purpose(filter: Filter, known: References, states: int) -> list[str]:
    """A description of the filter's inputs and outputs."""
    if isinstance(filter, AttitudeFilter):
        return wrapped(
            "From angular velocity, specific force (vectors[0], [m/s^2], 9.8 upwards at rest) and "
            "magnetic field (vectors[1], any unit; weight 0 without one) it estimates the "
            "attitude. It begins upright and to the north by itself, from any attitude that "
            "posegsa_init is given. The inertial frame is written into the step; posegsa_vectors "
            "only shows it. Filter: AttitudeFilter."
        )
    sensors = sensors_in_words(len(known.vectors), len(known.landmarks))
    kind = f"Filter: {type(filter).__name__}"
    kind += f" with {states} states" if states else ""
    return wrapped(
        f"From measured angular and linear velocity, {sensors} of "
        f"known direction or place it estimates attitude and position. {kind}."
    )
