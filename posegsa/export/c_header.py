"""The whole filter as one C99 header: state, `posegsa_init`, `posegsa_step`.

The arithmetic of the step is generated: JAX traces the model's own functions for one agent, part by
part, and `export.scalar_c` prints the traces as C. So every law, signal and schedule is exported as
the Python filter computes it, and a change of the model changes the export.

The step is traced in parts because one trace of all of it has 2300 operations: half are fuzzy rules
written out without tables, and each sub-step is repeated. Instead, a loop calls one function for
each sub-step, and the controller is written by hand with its tables (`controller.c`). Checks of the
input, missing measurements and return codes are written by hand too (`filter.h`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from posegsa import config
from posegsa.arguments import check_type, fitting, refuse
from posegsa.export.c_any import any_filter
from posegsa.export.c_gain import controller_values
from posegsa.export.c_step import References, Step, numbers, references, values_of
from posegsa.export.c_text import (
    NAME,
    check_name,
    comment,
    origin,
    renamed,
    sensors_in_words,
    settings_of,
    templates,
    whose_sensors,
    worth,
    wrapped,
)
from posegsa.filters.base import Filter, check_filter
from posegsa.filters.observer import FilterSettings, Observer, ObserverGains
from posegsa.judging.result import Result
from posegsa.model import limits
from posegsa.model.schedules import FuzzyGain, GainSchedule, KnotGain, check_schedule
from posegsa.model.signal import SignalSettings
from posegsa.version import VERSION
from posegsa.words import counted


def export_c(result: Result, name: str = NAME) -> str:
    """C99 header with the whole filter: state, `posegsa_init`, `posegsa_step`.

    It includes only `<math.h>`, allocates nothing, and computes in `POSEGSA_REAL`, which is double
    unless the compiler defines it as float. The comment at its top explains how to use it and how
    accurate the filter is.

    Args:
        result: The tuned filter. The header has the vectors, landmarks and weights of its
            experiment, or of the recordings that it was tuned on.
        name: Prefix of all names in the file.

    Raises:
        ArgumentError: Not a result, a name that is invalid in C, a result tuned on the true errors,
            which are unknown outside a simulation, or on recordings with different references.
    """
    check_type("result", result, Result)
    check_name(name)
    known = result.known_sensors
    double = replace(result, experiment=config.override(result.experiment, ["run.dtype=float64"]))
    filter = double.filter_for(len(known.vectors), len(known.landmarks))
    details = settings_of(result.tuned.filter)
    if isinstance(filter, Observer):
        if (schedule := result.candidate.schedule) is not None:  # as it was tuned, to the bit
            filter = replace(filter, schedule=schedule)
        details += settings_of(result.tuned.gain)
    return filter_to_c(
        filter,
        vectors=np.reshape(known.vectors, (-1, 3)),
        landmarks=np.reshape(known.landmarks, (-1, 3)),
        name=name,
        about=[*origin(result), *whose_sensors(result)],
        worth=worth(result),
        details=details,
    )


def filter_to_c(
    filter: Filter,
    *,
    vectors: ArrayLike | None = None,
    landmarks: ArrayLike | None = None,
    name: str = NAME,
    about: Iterable[str] = (),
    worth: Iterable[str] = ("Unknown: a filter made by hand.",),
    details: Iterable[str] = (),
) -> str:
    """C99 header of any filter; `export_c` writes that of a result.

    An observer without landmarks and without belief, and the `AttitudeFilter`, estimate the
    attitude only, and their measurements have no velocity. Any other filter estimates a pose, also
    without landmarks.

    Args:
        filter: An `Observer` with a schedule of `posegsa.model.schedules`, or one of your own; a
            `KalmanFilter`; an `AttitudeFilter`; or a filter of your own. The steps of a filter or
            of a schedule of your own must be arithmetic of scalars.
        vectors: (n, 3) v_i^I, inertial frame, in the unit of their sensor.
        landmarks: (m, 3) p_i, inertial frame [m].
        name: Prefix of all names in the file.
        about: Lines for the comment at the top: where the filter comes from.
        worth: Lines on its accuracy.
        details: Lines on its settings.

    Raises:
        ArgumentError: An argument has the wrong type, arguments do not fit together, or the filter
            can't be written as scalar arithmetic.
        MeasurementError: Vectors or landmarks are not finite, or a vector is 0.
    """
    check_filter("filter", filter)
    check_name(name)
    if isinstance(filter, Observer):
        _check_measured(filter.signal)
    if isinstance(filter, Observer) and not isinstance(filter.schedule, ObserverGains):
        template, values = "observer.h", _observer(filter, filter.schedule, vectors, landmarks)
    else:
        template, values = "any_filter.h", any_filter(filter, vectors, landmarks)
    values |= {
        "file": f"{name}.h",
        "origin": comment([*about] or [f"Written by posegsa {VERSION}."]),
        "worth": comment(worth),
        "settings": comment(details),
        "limits": _limits(values),
        "unit_tolerance": repr(limits.UNIT_TOLERANCE),
    }
    return renamed(templates().get_template(template).render(values), name)


def _observer(
    filter: Observer,
    schedule: GainSchedule | None,
    vectors: ArrayLike | None,
    landmarks: ArrayLike | None,
) -> dict[str, Any]:
    """The values for the template `observer.h`."""
    settings, signal = filter.settings, filter.signal
    if schedule is None:
        refuse("filter.schedule: None", "a gain schedule")
    with jax.enable_x64(True):
        check_schedule(schedule)
    check_type("filter.settings", settings, FilterSettings)
    with jax.enable_x64(True), fitting("filter_to_c: schedule"):
        initial_gain = float(schedule.initial_gain())
    known = references(vectors, landmarks, settings)
    step = Step(known, settings, signal, schedule)
    shared = values_of(step.pieces, step.numbers, known)
    kind = "an attitude" if step.attitude_only else "a pose"
    values = shared | {
        "title": f"{kind} filter with a scheduled gain",
        "attitude_only": step.attitude_only,
        "may_be_set": ", and set",
        "purpose": comment(_purpose(known, settings, step)),
        "substeps": settings.substeps,
        "learns": step.learns,
        "waits": step.waits,
        "turning": step.learns,
        "fuzzy": isinstance(schedule, FuzzyGain),
        "initial_gain": repr(initial_gain),
        "unknown": None if signal.unknown is None else repr(float(signal.unknown.start)),
        "controller": "",
        "knots": "",
    }
    if isinstance(schedule, KnotGain):
        values |= {"uses_time": True, "functions": sorted({"exp", *shared["functions"]})}
        values["knots"] = templates().get_template("knots.c").render(_knots(schedule))
    if isinstance(schedule, FuzzyGain):
        controller = controller_values(schedule.controller)
        template = templates().get_template("controller.c")
        values["controller"] = template.render(linkage="static inline ", **controller)
    return values


def _check_measured(signal: SignalSettings) -> None:
    """Refuse an error signal that needs the truth."""
    check_type("filter.signal", signal, SignalSettings)
    if signal.signal == "pose":
        refuse(
            'signal = "pose": the gain uses the true errors, which no vehicle knows, so the '
            "filter can't run outside a simulation",
            '"measured"; tune with gain.signal = "measured"',
        )


def _limits(values: Mapping[str, Any]) -> list[dict[str, str]]:
    """The limits that apply to a filter, as C macros."""
    found = [
        ("MIN_TIME_STEP", limits.TIME_STEP.low, "[s]"),
        ("MAX_TIME_STEP", limits.TIME_STEP.high, "[s]; after a longer pause start a new filter"),
        ("MAX_ANGULAR_VELOCITY", limits.ANGULAR_VELOCITY.high, "[rad/s]"),
    ]
    if values["vectors"]:
        found += [("MAX_VECTOR", limits.VECTOR.high, "in the unit of the sensor")]
    if not values["attitude_only"]:
        found += [
            ("MAX_VELOCITY", limits.VELOCITY.high, "[m/s]"),
            ("MAX_LANDMARK", limits.LANDMARK.high, "relative to the body [m]"),
            ("MAX_POSITION", limits.POSITION.high, "initial position [m]"),
        ]
    found += [("MAX_WEIGHT", limits.WEIGHT.high, "factors on s_i")]
    return [
        {"name": f"{NAME.upper()}_{name}", "value": f"{value:g}", "about": about}
        for name, value, about in found
    ]


def _knots(schedule: KnotGain) -> dict[str, object]:
    """The values for the template `knots.c`."""
    time, log_gain = (np.asarray(a, np.float64) for a in (schedule.time, schedule.log_gain))
    fits = time.ndim == 1 and time.shape == log_gain.shape and time.size > 0
    if not (fits and np.isfinite([time, log_gain]).all() and (np.diff(time) > 0).all()):
        refuse(
            f"schedule: a KnotGain of times {time.tolist()} and log_gains {log_gain.tolist()}",
            "ascending times, and a finite log_gain for each",
        )
    tables = {"times": numbers(time.tolist()), "log_gains": numbers(log_gain.tolist())}
    return {"count": len(time), **tables}


def _purpose(known: References, settings: FilterSettings, step: Step) -> Sequence[str]:
    """A description of the filter's inputs and outputs."""
    sensors = sensors_in_words(len(known.vectors), len(known.landmarks))
    rates = "angular velocity" if step.attitude_only else "angular and linear velocity"
    out = "attitude" if step.attitude_only else "attitude and position"
    biases = "bias of the angular velocity" if step.attitude_only else "biases of both velocities"
    if step.learns:
        biases += " and of the vectors"
    return wrapped(
        f"The filter estimates {out}, and also the {biases}. It uses the measured {rates}, and "
        f"{sensors} of known "
        f"{'direction' if step.attitude_only else 'direction or position'}. "
        f"Law: {settings.law}; {counted(settings.substeps, 'sub-step')} per sample. The "
        f"equations are in posegsa/filters/observer.py."
    )
