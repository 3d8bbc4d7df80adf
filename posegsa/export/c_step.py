"""The parts of a filter's step as C functions, and their constants.

Each part is a function of `posegsa.model` or `posegsa.filters`. It is traced with records that hold
the C expression of each scalar: a field of the state, of the measurement or of the step's work
space, a `static const`, or a number if the filter does not have that scalar.
"""

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import refuse
from posegsa.export.scalar_c import Code, literal, written
from posegsa.export.scalar_loops import written_in_loops
from posegsa.export.scalar_trace import Known
from posegsa.filters.observer import (
    FilterSettings,
    bias_share,
    displacement,
    learning_time,
    learnt_biases,
    learnt_vector_biases,
    limited_correction,
    see,
)
from posegsa.model import se3
from posegsa.model.elementwise import choose
from posegsa.model.estimate import FilterState
from posegsa.model.first_pose import shown
from posegsa.model.limits import POSITION, VECTOR
from posegsa.model.measurements import Measurements, finite_array
from posegsa.model.sample import LandmarkSample, Sample, Seen, prepare
from posegsa.model.schedules import FuzzyGain, Gains, GainSchedule, KnotGain, ScheduleInputs
from posegsa.model.signal import (
    SignalMemory,
    SignalSettings,
    measured_errors,
    scheduled_gain,
    still_unknown,
)
from posegsa.model.vectors import AS_MEASURED, VectorSample, VectorSamples, Wahba

_NOTHING: Any = (0.0, 0.0, 0.0)
"""A vector that a filter does not have. (Typed `Any`: the model's records hold arrays, but here
they hold an `export.scalar_trace.Argument` for each number.)"""

IN_TABLES = (FuzzyGain, KnotGain)
"""Schedules with tables. They are not traced but written by hand: `controller.c`, `knots.c`."""

_NUMBERS = {
    "gamma_angular": ("", "gain of the bias law of the angular velocity at K = 10/s [1/s^2]"),
    "gamma_linear": ("", "gain of the bias law of the velocity at K = 10/s [1/s^2]"),
    "length": ("", "l [m], unit of length in which attitude and position share the gain"),
    "length_growth": ("", "how much l^2 grows with the farthest landmark's squared distance"),
    "per_bias_wait": ("", "1 / w^2; w: the error at which the bias laws have half their gains"),
    "per_angular_bias_bound": ("", "1 / bound^2 of the angular velocity's bias [s^2/rad^2]"),
    "per_linear_bias_bound": ("", "1 / bound^2 of the velocity's bias [s^2/m^2]"),
    "gain_limit": ("", "largest step of the innovation, K h L"),
    "vectors.cross_weight": ("cross_vector_weight", "s_i of v_1 x v_2"),
    "vector_bias.gain": ("", "gamma_c, gain of the vectors' bias law at K = 10/s [1/s]"),
    "vector_bias.leak": ("", "rate at which a vector's bias is forgotten [1/s]"),
    "vector_bias.per_bound": ("", "1 / bound^2; bound: maximum length of a vector's bias"),
    "vector_bias.per_turning": ("", "1 / w_0^4, w_0 [rad/s]: above it gamma_c is full"),
    "vector_bias.excitation_time": ("", "time constant of that rate's low-pass filter [s]"),
    "position_weight": ("", "weight of the position part of the error [1/m]"),
    "smoothing": ("", "time constant of the error's low-pass filter [s]"),
    "error_scale": ("", "the error at which the scaled error is 1"),
    "rate_scale": ("", "factor on the change of the error"),
    "unknown.fall": ("", "how fast the unknown share of the biases falls, per K dt"),
    "unknown.rise": ("", "lower limit of the unknown share, as a factor on the scaled error"),
    "vectors.weights": ("weight_of_vector", "s_i of each vector"),
    "landmark_weights": ("weight_of_landmark", "s_i of each landmark [1/m^2]"),
}
"""The name in C ("" for the path) and the comment of each number, by its path in the settings."""


@dataclass(frozen=True)
class References:
    """The references of a filter's sensors."""

    vectors: np.ndarray
    """(n, 3) v_i^I, in the unit of their sensor."""
    directions: np.ndarray
    """(n + 1, 3) v_i^I as the innovation uses them, then the cross product v_1 x v_2."""
    landmarks: np.ndarray
    """(m, 3) p_i [m]."""


def references(
    vectors: ArrayLike | None, landmarks: ArrayLike | None, settings: FilterSettings
) -> References:
    """References as the model prepares them."""
    v, p = known_places(vectors, landmarks)
    for what, weights, count in (
        ("vectors.weights", settings.vectors.weights, len(v)),
        ("landmark_weights", settings.landmark_weights, len(p)),
    ):
        if weights is not None and len(weights) != count:
            refuse(f"settings.{what}: {len(weights)} of them", f"{count}, one for each, or None")
    with jax.enable_x64(True):
        in_loop = replace(settings.vectors, each_agent=True)
        prepared = prepare(one_measurement(v, p), in_loop).vectors
        assert isinstance(prepared, VectorSamples)
        return References(vectors=v, directions=directions_of(prepared), landmarks=p)


def known_places(
    vectors: ArrayLike | None, landmarks: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """The references of vectors (n, 3) and of landmarks (m, 3), checked."""
    v, p = (
        np.zeros((0, 3)) if a is None else limit.checked(name, finite_array(name, a, (None, 3)))
        for name, a, limit in (("vectors", vectors, VECTOR), ("landmarks", landmarks, POSITION))
    )
    if not len(v) + len(p):
        refuse("vectors and landmarks: none", "at least one of either")
    return v, p


def one_measurement(vectors: np.ndarray, landmarks: np.ndarray) -> Measurements:
    """What a body at rest, upright, at the origin, measures at one sample, in float64."""
    still = np.zeros((1, 3))
    return Measurements.from_arrays(
        time_step=1.0,
        angular_velocity=still,
        velocity=still,
        vectors=vectors[None],
        vector_references=vectors,
        landmarks=landmarks[None],
        landmark_references=landmarks,
        dtype=np.float64,
    ).at(0)


def directions_of(samples: VectorSamples) -> np.ndarray:
    """(n + 1, 3) the references of vectors as an innovation uses them, and their cross product."""
    used = [vector.reference for vector in samples.each] + [samples.cross_reference]
    return np.array(used, np.float64)


@dataclass(frozen=True)
class Piece:
    """One C function."""

    name: str
    about: str
    code: Code
    body: str

    @classmethod
    def of(cls, name: str, about: str, code: Code) -> "Piece":
        """The function with these statements."""
        about = f"{about[0].upper()}{about[1:]}."
        return cls(name=name, about=about, code=code, body=code.text(4))

    @property
    def _parameters(self) -> dict[str, str]:
        kinds = {
            "now": "const posegsa_state *now",
            "seen": "const posegsa_measurement *seen",
            "dt": "posegsa_real dt",
            "farthest": "posegsa_real farthest",
            "h": "posegsa_real h",
            "moving": "posegsa_real moving",
            "w": "posegsa_work *w",
            "next": "posegsa_state *next",
            "rotation": "posegsa_real rotation[3][3]",
            "pose": "posegsa_real pose[8]",
        }
        return {name: kind for name, kind in kinds.items() if self.code.mentions(name)}

    @property
    def signature(self) -> str:
        """Its parameter list, wrapped."""
        lines, indent = [""], " " * len(f"static inline void posegsa_{self.name}(")
        for kind in self._parameters.values():
            joined = f"{lines[-1]}, {kind}" if lines[-1] else kind
            if len(indent) + len(joined) > 98:
                lines[-1] += ","
                lines.append(kind)
            else:
                lines[-1] = joined
        return f"\n{indent}".join(lines)

    @property
    def call(self) -> str:
        """The statement that calls it, with variables named like its parameters."""
        if not self.code.statements:
            return ""
        return f"posegsa_{self.name}({', '.join(self._parameters)});"


class Step:
    """The parts of a filter's step as C functions, and their constants."""

    def __init__(
        self,
        known: References,
        settings: FilterSettings,
        signal: SignalSettings,
        schedule: GainSchedule,
    ) -> None:
        self.pieces: dict[str, Piece] = {}
        self.numbers: list[tuple[Known, str]] = []
        self.vectors, self._landmarks = len(known.vectors), len(known.landmarks)
        self.attitude_only = not self._landmarks
        self.learns = settings.vector_bias is not None and self.vectors > 0
        if not self.learns:
            settings = replace(settings, vector_bias=None)
        self.waits, self.unknown = settings.per_bias_wait is not None, signal.unknown is not None
        settings = replace(settings, vectors=replace(settings.vectors, each_agent=True))
        self._known, self._plain = known, settings
        self._settings = self._named(settings)
        self._signal = self._named(signal)
        self._write(schedule)

    def _write(self, schedule: GainSchedule) -> None:
        settings, now, following = self._settings, self._state("now"), self._state("next")
        sample, seen = self._sample(), self._seen()
        names = ("see", "the vectors without their biases, Wahba's sums, and the weights")
        self._piece(*names, see, (now, sample, settings), _wanted(seen))
        memory = self._memory("now")
        self._piece(
            *("signal", "the error signal: the low-passed misfit of the estimate and the sample"),
            _signal,
            (now, sample, seen, memory, self._signal, settings),
            (
                ("w->error", "w->rate"),
                _wanted(self._memory("next")._replace(gain=_scalar(0.0))),
                ("w->share",) if self.waits else (),
            ),
        )
        if not isinstance(schedule, IN_TABLES):
            inputs = ScheduleInputs(
                *map(_scalar, ("w->error", "w->rate", "now->time", "now->gain"))
            )
            named = self._named(schedule, "schedule.")
            self._piece(
                *("schedule", f"{type(schedule).__name__}: the gain before the gain limit"),
                lambda schedule, inputs: tuple(jax.tree.leaves(schedule.prepare()(inputs))),
                (named, inputs),
                ("w->gain", "w->learning"),
            )
        moved = None if self.attitude_only else vec3("w->v")
        self._piece(
            *("correct", "the innovation U, its gain after the limit, and the bias laws"),
            _correct,
            (following, sample, seen, "w->gain", "h", "moving", settings, self._share),
            (
                "w->used",
                (vec3("w->omega"), moved or (None,) * 3, "w->angle_squared"),
                (following.bias_angular, _wanted(following.bias_linear)),
            ),
        )
        coefficients = numbered("w->exponential", 4)
        both = [
            written(se3.exp_coefficients, ("w->angle_squared",), coefficients, dtype)
            for dtype in (np.float32, np.float64)
        ]
        self.pieces["exponential"] = Piece(
            name="exponential",
            about="Coefficients of the exponential of SE(3); the type sets the number of terms.",
            code=Code(
                both[0].statements + both[1].statements, both[0].functions | both[1].functions
            ),
            body="    if (sizeof(posegsa_real) < sizeof(double)) {\n"
            f"{both[0].text(8)}\n    }} else {{\n{both[1].text(8)}\n    }}",
        )
        omega, v = vec3("w->omega"), _NOTHING if self.attitude_only else vec3("w->v")
        self._piece(
            *("move", "moves the estimate by w->omega and w->v"),
            se3.displaced,
            (following.attitude, following.place, omega, v, coefficients),
            (following.attitude, _wanted(following.place)),
        )
        if self.learns:
            learning = 1.0 if isinstance(schedule, IN_TABLES) else "w->learning"
            self._piece(
                *("learn", "the vectors' biases, from the residuals at the sample"),
                learnt_vector_biases,
                (now, sample, seen, learning, "w->used", settings, self._share),
                (following.vector_biases, following.turning),
            )
        if self.unknown:
            self._piece(
                *("know", "the unknown share of the biases after the sample"),
                lambda memory, sample, seen, used, signal, share: (
                    still_unknown(memory, seen, learning_time(sample, used, share), signal).unknown,
                ),
                (self._memory("next"), sample, seen, "w->used", self._signal, self._share),
                ("next->unknown",),
            )
        self.pieces["rows"] = rotation_matrix()
        self.pieces |= shown_pose(sample, self._known, self._plain, self.attitude_only)

    def _piece(
        self, name: str, about: str, function: Callable[..., Any], arguments: Any, results: Any
    ) -> None:
        self.pieces[name] = Piece.of(name, about, written(function, arguments, results))

    def _named(self, settings: Any, prefix: str = "") -> Any:
        """The settings with a C name in place of each number."""

        def name(path: Any, leaf: Any) -> Known:
            if np.ndim(leaf):
                of = prefix.rstrip(".") or "settings"
                refuse(f"{of} with arrays of numbers", "one made of scalars")
            key, bracket, index = jax.tree_util.keystr(path).lstrip(".").partition("[")
            own, about = _NUMBERS.get(prefix + key, ("", ""))
            text = own or (prefix + key).replace(".", "_")
            number = Known(f"posegsa_{text}{bracket}{index}", float(np.asarray(leaf)))
            self.numbers.append((number, about))
            return number

        return jax.tree_util.tree_map_with_path(name, settings)

    @property
    def _share(self) -> Any:
        """The factor on the gains of all bias laws, if they have one."""
        return "w->share" if self.waits else None

    def _state(self, pointer: str) -> FilterState:
        whole = estimate_in_c(f"{pointer}->", self.vectors if self.learns else 0, self.learns)
        if self.attitude_only:
            return whole._replace(place=_NOTHING, bias_linear=_NOTHING)
        return whole

    def _sample(self) -> Sample:
        return sample_of(
            self.vectors,
            self._landmarks,
            crossed=self._settings.vectors.cross and self.vectors >= 2,
            velocity=_NOTHING if self.attitude_only else vec3("seen->velocity"),
            farthest="w->reach",
        )

    def _seen(self) -> Seen:
        some = self.vectors > 0
        return Seen(
            wahba=Wahba(
                profile=tuple(vec3(f"w->profile[{i}]") if some else _NOTHING for i in range(3)),
                power=_scalar("w->power" if some else 0.0),
                curvature=_scalar("w->curvature" if some else 0.0),
                scale=_scalar("w->scale" if some else 0.0),
            ),
            freed=tuple(
                vec3(f"w->freed[{i}]") if self.learns else _NOTHING for i in range(self.vectors)
            ),
            landmark_weights=numbered("w->landmark_weights", self._landmarks),
        )

    def _memory(self, pointer: str) -> SignalMemory:
        return SignalMemory(
            attitude=_scalar(f"{pointer}->attitude_error" if self.vectors else 0.0),
            position=_scalar(f"{pointer}->position_error" if self._landmarks else 0.0),
            error=_scalar(f"{pointer}->error"),
            gain=_scalar(f"{pointer}->gain"),
            time_step=_scalar(f"{pointer}->since_last"),
            unknown=_scalar(f"{pointer}->unknown") if self.unknown else (),
        )


def estimate_in_c(pointer: str, learnt: int, turning: bool) -> FilterState:
    """An estimate with the fields of the struct in C, of so many vectors' biases."""
    return FilterState(
        attitude=numbered(f"{pointer}attitude", 4),
        place=vec3(f"{pointer}position"),
        bias_angular=vec3(f"{pointer}bias_angular"),
        bias_linear=vec3(f"{pointer}bias_linear"),
        vector_biases=tuple(vec3(f"{pointer}vector_bias[{i}]") for i in range(learnt)),
        turning=vec3(f"{pointer}turning") if turning else (),
    )


def sample_of(
    vectors: int, landmarks: int, *, crossed: bool, velocity: Any, farthest: str
) -> Sample:
    """A sample whose numbers are C expressions, of the measurement `seen` and the reference tables.

    Args:
        vectors: Number of measured vectors.
        landmarks: Number of measured landmarks.
        crossed: Whether the cross product of two vectors is used.
        velocity: The velocity in C.
        farthest: The variable with the square of the distance to the farthest landmark [m^2].
    """
    return Sample(
        time_step=_scalar("dt"),
        angular_velocity=vec3("seen->angular_velocity"),
        velocity=velocity,
        vectors=VectorSamples(
            tuple(
                VectorSample(
                    measured=vec3(f"seen->vectors[{i}]"),
                    known=vec3(f"posegsa_vectors[{i}]"),
                    reference=vec3(f"posegsa_directions[{i}]"),
                    factor=_scalar(f"seen->vector_weights[{i}]"),
                )
                for i in range(vectors)
            ),
            vec3(f"posegsa_directions[{vectors}]") if crossed else _NOTHING,
        ),
        landmarks=tuple(
            LandmarkSample(
                body=vec3(f"seen->landmarks[{i}]"),
                inertial=vec3(f"posegsa_landmarks[{i}]"),
                factor=_scalar(f"seen->landmark_weights[{i}]"),
            )
            for i in range(landmarks)
        ),
        reach=_scalar(farthest if landmarks else 0.0),
    )


def shown_pose(
    sample: Sample, known: References, settings: FilterSettings | None, attitude_only: bool
) -> dict[str, Piece]:
    """The function that finds the pose that a sample shows, by its name; none if no sample can.

    `pose` is 1 where the sample fixes it and else 0, then the quaternion and the position.

    Args:
        sample: Of `sample_of`.
        known: The references of its sensors.
        settings: An observer's; sensors without weight are not asked.
        attitude_only: Whether there is no position.
    """
    own = (
        (None, None) if settings is None else (settings.vectors.weights, settings.landmark_weights)
    )
    with jax.enable_x64(True):
        exact = prepare(one_measurement(known.vectors, known.landmarks), AS_MEASURED)
        vectors, landmarks = _asked(sample, *own)
        if len(vectors) + len(landmarks) < 2 or not shown(*_asked(exact, *own)).fixed:
            return {}

    def numbers(vectors: Any, landmarks: Any) -> Any:
        fixed, attitude, place = shown(vectors, landmarks)
        return choose(fixed, jnp.ones_like(attitude[0]), 0.0), *attitude, *place

    places = (None, None, None) if attitude_only else numbered("pose", 8)[5:]
    results = (*numbered("pose", 5), *places)
    code = written_in_loops(numbers, (vectors, landmarks), results)
    return {"show": Piece.of("show", "the pose that a measurement shows, if it fixes one", code)}


def _asked(sample: Sample, of_vectors: Any, of_landmarks: Any) -> tuple[Any, Any]:
    """The vectors and landmarks of a sample whose weights in the filter are not 0."""
    assert isinstance(sample.vectors, VectorSamples)
    vectors, landmarks = (
        tuple(
            one
            for i, one in enumerate(sensors)
            if weights is None or float(np.asarray(weights[i])) > 0
        )
        for sensors, weights in (
            (sample.vectors.each, of_vectors),
            (sample.landmarks, of_landmarks),
        )
    )
    return vectors, landmarks


def rotation_matrix() -> Piece:
    """The function that makes a matrix of the attitude."""
    rotation = tuple(vec3(f"rotation[{i}]") for i in range(3))
    code = written(se3.rows, (numbered("now->attitude", 4),), rotation)
    return Piece.of("rows", "the attitude as a matrix", code)


def _signal(
    state: FilterState,
    sample: Sample,
    seen: Seen,
    memory: SignalMemory,
    settings: SignalSettings,
    laws: FilterSettings,
) -> tuple[tuple[Any, Any], SignalMemory, tuple[Any, ...]]:
    """The inputs of a schedule, the memory after the sample, and the share of the bias laws."""
    errors, step = measured_errors(state, sample, seen), sample.time_step
    # Only the inputs are used, so the schedule and the time do not matter.
    _, inputs, after = scheduled_gain(
        lambda inputs: Gains(inputs.last), memory, errors, step, step, settings
    )
    share = bias_share(after, laws, settings)
    return (inputs.error, inputs.rate), after, () if share is None else (share,)


def _correct(
    state: FilterState,
    sample: Sample,
    seen: Seen,
    gain: Any,
    h: Any,
    moving: Any,
    settings: FilterSettings,
    share: Any,
) -> Any:
    """A sub-step of `filters.observer.observe` up to its exponential."""
    W, used = limited_correction(state, sample, seen, gain, h, settings)
    omega, v = displacement(state, sample, W, used, h, moving)
    biases = learnt_biases(state, sample, W, used, h, settings, share)
    return used, (omega, v, se3.dot(omega, omega)), biases


def _scalar(argument: str | float) -> Any:
    return argument


def numbered(array: str, count: int) -> Any:
    """The first `count` numbers of a C array."""
    return tuple(f"{array}[{i}]" for i in range(count))


def vec3(array: str) -> Any:
    """The three numbers of a C array."""
    return f"{array}[0]", f"{array}[1]", f"{array}[2]"


def _wanted(record: Any) -> Any:
    """The variables to set; None for a number."""
    return jax.tree.map(lambda leaf: leaf if isinstance(leaf, str) else None, record)


def values_of(
    pieces: Mapping[str, Piece], named: Iterable[tuple[Known, str]], known: References
) -> dict[str, Any]:
    """The values that the templates of all filters have; arguments as of `_constants`."""
    codes = [piece.code for piece in pieces.values()]
    return {
        "vectors": len(known.vectors),
        "landmarks": len(known.landmarks),
        "uses_time": any(code.mentions("now->time") for code in codes),
        "constants": _constants(codes, named, known),
        "functions": sorted({"sqrt"}.union(*(code.functions for code in codes))),
        "pieces": [piece for piece in pieces.values() if piece.code.statements],
        "calls": {key: piece.call for key, piece in pieces.items()},
    }


def _constants(codes: Sequence[Code], named: Iterable[tuple[Known, str]], known: References) -> str:
    """The constants that a step uses, as `static const`.

    Args:
        codes: The functions of the step.
        named: The numbers of the filter with their comments.
        known: The references of its sensors.
    """

    def used(name: str) -> bool:
        return any(code.mentions(name) for code in codes)

    lines: list[str] = []

    def define(name: str, about: str, size: str, value: str, always: bool = False) -> None:
        if always or used(name):
            lines.extend([f"/* {about} */"] if about else [])
            lines.append(f"static const posegsa_real {name}{size} = {value};")

    arrays: dict[str, list[float]] = {}
    for number, about in named:
        name, bracket, _ = number.text.partition("[")
        if bracket:
            arrays.setdefault(name, []).append(number.value)
        else:
            define(name, about, "", literal(number.value))
    for own, about in _NUMBERS.values():
        values = arrays.get(f"posegsa_{own}", [])
        if values:
            define(f"posegsa_{own}", about, f"[{len(values)}]", _row(values))
    for name, about, rows in (
        ("vectors", "v_i, inertial frame, in the unit of their sensor", known.vectors),
        ("directions", "v_i as the innovation uses them, then v_1 x v_2", known.directions),
        ("landmarks", "p_i [m], inertial frame", known.landmarks),
    ):
        table = ",\n    ".join(map(_row, rows.tolist()))
        # The user needs the references too, as in the example at the top of the file.
        always = len(rows) > 0 and name != "directions"
        define(f"posegsa_{name}", about, f"[{len(rows)}][3]", f"{{\n    {table}\n}}", always)
    return "\n".join(lines)


def _row(values: Iterable[float]) -> str:
    return f"{{{', '.join(map(literal, values))}}}"


def numbers(values: Iterable[float]) -> str:
    """Numbers as the lines of a table."""
    text = ", ".join(map(literal, values))
    return textwrap.indent("\n".join(textwrap.wrap(text, 92)), "    ")
