"""Sensors with time stamps of their own, put on one clock.

Each sample of a stream goes to the nearest stamp of the clock, and the stream is missing (NaN) at
the clock's other samples. A stream can be held or interpolated instead. Velocities are needed at
each sample; by default they are held, so that the filter has the value that it would have live.
Notes say for each stream what was done.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array
from posegsa.recordings.bridging import ALLOWED, GAP, advancing
from posegsa.recordings.policies import LONGEST_GAP, Policy
from posegsa.words import counted

Stream: TypeAlias = tuple[ArrayLike, ArrayLike]
"""Time stamps (N,), integers in ns or floats in s, and values (N, 3), of a quaternion (N, 4)."""
Between: TypeAlias = Literal["missing", "hold", "interpolate"]
"""Value of a stream at the clock's stamps between two of its own: missing, its last value, or
interpolated linearly (a quaternion along the shortest rotation)."""
VELOCITIES = "angular_velocity", "velocity"
TRUTH, QUATERNION = "truth", "truth_quaternion"


class _Stream(NamedTuple):
    """A stream without missing samples, whose stamps ascend."""

    name: str
    time: np.ndarray
    """(N,) since the first stamp of the clock [s]."""
    values: np.ndarray
    """(N, d)"""

    @property
    def step(self) -> float:
        """The median time between two samples [s]."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0


def on_one_clock(
    streams: Mapping[str, Stream | Sequence[Stream]],
    *,
    clock: str | ArrayLike,
    between: Mapping[str, Between] | None = None,
    bridge: Policy = "refuse",
    longest: float = LONGEST_GAP,
) -> dict[str, Any]:
    """Arguments of `Recording.from_arrays` from streams; see `Recording.from_streams`.

    Args:
        streams: one for each quantity, a list of them for "vectors" and "landmarks".
        clock: the name of a stream, or stamps (K,), integers in ns or floats in s.
        between: what to do between samples, by quantity; "truth" is both of its quantities.
        bridge: unless "refuse", samples whose stamps go back are dropped.
        longest: the longest time over which a value is held or interpolated [s].

    Raises:
        RecordingError: streams do not overlap, stamps go back, or an argument is not allowed.
        MeasurementError: an array has the wrong shape or forbidden values.
    """
    named = dict(_named(streams))
    ways = _ways(between or {}, streams)
    kept, notes, origin = _clock(clock, named, bridge)
    ticks = _since(kept, origin)
    columns: dict[str, np.ndarray] = {}
    used = np.ones(len(ticks), bool)
    for name, (quantity, given) in named.items():
        stream, dropped = _checked(name, given, origin, bridge)
        notes += dropped
        _check_overlap(stream, ticks)
        own = isinstance(clock, str) and name == clock  # has a sample at each stamp
        way = "missing" if own else ways.get(quantity, "missing")
        columns[name], note = _at(ticks, stream, way, longest)
        if own:
            continue
        if not np.array_equal(stream.time, ticks):
            notes.append(note)
        if quantity in VELOCITIES:
            last = stream.time[-1] + (stream.step if way == "hold" else 0.0)
            used &= (ticks >= stream.time[0]) & (ticks <= last)
    inside = np.flatnonzero(used)
    if inside.size < 2:
        raise RecordingError("angular_velocity, velocity: the clock has no two stamps within both")
    part = slice(int(inside[0]), int(inside[-1]) + 1)
    if left := len(ticks) - (part.stop - part.start):
        notes.append(f"{counted(left, 'sample')} without velocities left out, at the ends")
    found: dict[str, Any] = {"time": ticks[part], "origin": origin.item(), "notes": tuple(notes)}
    for quantity, given in streams.items():
        each = [columns[name][part] for name, (own, _) in named.items() if own == quantity]
        found[quantity] = each[0] if _is_stream(given) else np.stack(each, axis=1)
    return found


def _is_stream(given: object) -> bool:
    """Whether this is one stream, a pair of stamps and values, and not a list of them."""
    return isinstance(given, tuple) and len(given) == 2 and np.ndim(given[0]) == 1


def _named(streams: Mapping[str, Any]) -> Iterator[tuple[str, tuple[str, Stream]]]:
    """For the name of each stream, such as "landmarks[0]", its quantity and itself."""
    for quantity, given in streams.items():
        each = {quantity: given}
        several = quantity in ("vectors", "landmarks") and not _is_stream(given)
        if several and isinstance(given, Sequence):
            each = {f"{quantity}[{number}]": one for number, one in enumerate(given)}
        for name, one in each.items():
            if not _is_stream(one):
                raise RecordingError(
                    f"{name}: {type(one).__name__}; allowed: a pair of time stamps (N,) and values "
                    "(N, 3), of vectors and landmarks a list of pairs"
                )
            yield name, (quantity, one)


def _ways(between: Mapping[str, Between], streams: Mapping[str, Any]) -> dict[str, Between]:
    """What to do between the samples of each quantity."""
    ways: dict[str, Between] = dict.fromkeys(VELOCITIES, "hold")
    for name, way in between.items():
        both = (f"{TRUTH}_quaternion", f"{TRUTH}_position") if name == TRUTH else (name,)
        quantities = [quantity for quantity in streams if quantity in both]
        if not quantities:
            raise RecordingError(f"between: {name!r}; allowed: {', '.join(streams)}")
        if way not in get_args(Between):
            raise RecordingError(
                f"between: {name} = {way!r}; allowed: {', '.join(get_args(Between))}"
            )
        if way == "missing" and name in VELOCITIES:
            raise RecordingError(
                f"between: {name} = {way!r}; allowed: hold, interpolate, as each sample needs it"
            )
        ways |= dict.fromkeys(quantities, way)
    return ways


def _clock(
    clock: str | ArrayLike, named: Mapping[str, tuple[str, Stream]], bridge: Policy
) -> tuple[np.ndarray, list[str], Any]:
    """The stamps of the clock, what was dropped, and the first stamp."""
    name = clock if isinstance(clock, str) else "clock"
    if isinstance(clock, str):
        if clock not in named:
            raise RecordingError(f"clock = {clock!r}; allowed: time stamps, or {', '.join(named)}")
        clock = named[clock][1][0]
    kept, dropped = _ascending(name, _stamps(name, clock), bridge)
    if len(kept) < 2:
        raise RecordingError(f"{name}: {counted(len(kept), 'sample')}; allowed: 2 or more")
    return kept, [] if name in named else dropped, kept[0]


def _stamps(name: str, time: ArrayLike) -> np.ndarray:
    given = np.asarray(time)
    if given.dtype.kind in "iu" and given.ndim == 1:
        return given.astype(np.int64)
    return finite_array(f"{name}: time", given, (None,))


def _ascending(name: str, time: np.ndarray, bridge: Policy) -> tuple[np.ndarray, list[str]]:
    """The stamps that are after all before them, and what was dropped, in words."""
    kept = advancing(time) if len(time) else np.ones(0, bool)
    if kept.all():
        return time, []
    k = int(np.argmin(kept))
    words = f"{counted(int((~kept).sum()), 'stamp')} not after the one before, first at sample {k}"
    if bridge == "refuse":
        raise RecordingError(f"{name}: {words}; {ALLOWED}, which drops them")
    return time[kept], [f"{name}: {words}: dropped"]


def _since(time: np.ndarray, origin: Any) -> np.ndarray:
    """Time (N,) since the first stamp of the clock [s]."""
    if time.dtype.kind == "i" and isinstance(origin, np.integer):
        return (time - origin) / 1e9  # as integers first: float64 cannot hold all digits of ns
    seconds = time / 1e9 if time.dtype.kind == "i" else time
    return seconds - (origin / 1e9 if isinstance(origin, np.integer) else origin)


def _checked(name: str, given: Stream, origin: Any, bridge: Policy) -> tuple[_Stream, list[str]]:
    """A stream since the first stamp of the clock, and what was dropped, in words."""
    time = _stamps(name, given[0])
    size = 4 if name == QUATERNION else 3
    values = finite_array(name, given[1], (len(time), size), finite=False)
    known = np.isfinite(values).all(axis=1)
    notes = []
    if missing := int((~known).sum()):
        notes.append(f"{name}: {counted(missing, 'sample')} that are NaN left out")
    time, values = time[known], values[known]
    if not len(time):
        raise RecordingError(f"{name}: no sample is finite")
    ascending, dropped = _ascending(name, time, bridge)
    values = values[advancing(time)]
    return _Stream(name, _since(ascending, origin), values), [*notes, *dropped]


def _check_overlap(stream: _Stream, ticks: np.ndarray) -> None:
    if stream.time[-1] < ticks[0] or stream.time[0] > ticks[-1]:
        raise RecordingError(
            f"{stream.name}: its stamps are {stream.time[0]:.6g} to {stream.time[-1]:.6g} s after "
            f"the clock's first, the clock's up to {ticks[-1]:.6g} s; allowed: stamps by the same "
            "clock, integers in ns or floats in s"
        )


def _at(ticks: np.ndarray, stream: _Stream, way: Between, longest: float) -> tuple[np.ndarray, str]:
    """Values (K, d) of a stream at the stamps of the clock, and what was done, in words."""
    rate = f" at {1 / stream.step:.4g} Hz" if stream.step else ""
    what = f"{stream.name}: {counted(len(stream.time), 'sample')}{rate}"
    if way == "missing":
        values, words = _nearest(ticks, stream)
        return values, f"{what}, {words}"
    before = np.searchsorted(stream.time, ticks, side="right") - 1
    known = before >= 0
    if way == "hold":
        known &= ticks - stream.time[before] <= longest
        values = stream.values[before]
        words = "held in between"
    else:
        after = np.searchsorted(stream.time, ticks, side="left")
        known &= after < len(stream.time)
        ends = np.minimum(after, len(stream.time) - 1)
        known &= stream.time[ends] - stream.time[before] <= longest
        values = _interpolated(np.clip(ticks, stream.time[0], stream.time[-1]), stream)
        words = "interpolated in between"
    return np.where(known[:, None], values, np.nan), f"{what}, {words}"


def _interpolated(time: np.ndarray, stream: _Stream) -> np.ndarray:
    """Values (K, d) at times within those of a stream."""
    if stream.name == QUATERNION and len(stream.time) > 1:
        from scipy.spatial.transform import Rotation, Slerp  # slow to load

        turned = Slerp(stream.time, Rotation.from_quat(stream.values, scalar_first=True))
        return turned(time).as_quat(scalar_first=True)
    each = [np.interp(time, stream.time, column) for column in stream.values.T]
    return np.stack(each, axis=1)


def _nearest(ticks: np.ndarray, stream: _Stream) -> tuple[np.ndarray, str]:
    """Values (K, d), each sample at the nearest stamp of the clock and NaN elsewhere."""
    usual = float(np.median(np.diff(ticks)))
    right = np.clip(np.searchsorted(ticks, stream.time), 1, len(ticks) - 1)
    left = right - 1
    at = np.where(stream.time - ticks[left] <= ticks[right] - stream.time, left, right)
    away = np.abs(stream.time - ticks[at])
    outside = (stream.time < ticks[0]) | (stream.time > ticks[-1])
    apart = outside | (ticks[right] - ticks[left] > GAP * usual)
    near = np.flatnonzero(~apart | (away <= 0.5 * usual))
    # If several samples go to one stamp, the nearest is written last and stays.
    order = near[np.argsort(-away[near], kind="stable")]
    values = np.full((len(ticks), stream.values.shape[1]), np.nan)
    values[at[order]] = stream.values[order]
    used = len(np.unique(at[near]))
    most = float(away[near].max(initial=0.0))
    words = f"each at the nearest sample of the clock, up to {1e3 * most:.3g} ms away"
    if most == 0:
        words = "at samples of the clock"
    if beyond := len(stream.time) - len(near):
        words += f"; {beyond} outside it left out"
    if same := len(near) - used:
        words += f"; {same} left out, as another is nearer to the same sample"
    return values, words
