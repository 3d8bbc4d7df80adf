"""Mamdani fuzzy inference: triangular terms, rule base, centroid.

Two inputs, the error and its rate, share one set of terms; min is the AND and the implication, max
the aggregation, the centroid the defuzzification. A `FuzzyController` works on its own:

    controller = FuzzyController(input_terms, output_terms, rules)
    gain = controller(error, rate)

Terms are ordered from small to large (VS, S, M, L, VL). `rules[r][e]` is the output term for rate
term r and error term e.
"""

from dataclasses import dataclass, field
from functools import reduce
from numbers import Real
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from posegsa.arguments import fitting
from posegsa.errors import FuzzyError
from posegsa.model.elementwise import choose, maximum, minimum

Centroid = Literal["exact", "sampled"]
SampledRule = Literal["sum", "trapezoid"]
NoRule = Literal["hold", "midrange"]
Rules = tuple[tuple[int, ...], ...]
Heights = tuple[Array, ...]


class Slopes(NamedTuple):
    """A triangular term in the form that `membership` evaluates."""

    peak: Array
    rise: Array
    """1 / (b - a), huge where the left edge is vertical."""
    fall: Array
    """1 / (c - b), huge where the right edge is vertical."""


class Overlap(NamedTuple):
    """Coefficients of area and moment under two output terms i <= j clipped at one height.

    F(h) = D h - (u + v) h^2/2 and M(h) = 1/2 [(c_i^2 - a_j^2) h - (c_i v + a_j u) h^2 + (v^2 - u^2)
    h^3/3] with u = b_j - a_j, v = c_i - b_i, D = c_i - a_j, for h up to p = min(1, D / (u + v)),
    none if D <= 0.
    """

    cap: Array
    area: tuple[Array, Array]
    moment: tuple[Array, Array, Array]


class PreparedController(NamedTuple):
    """Everything that depends only on the terms, computed once per controller."""

    inputs: tuple[Slopes, ...]
    overlaps: tuple[tuple[Overlap, ...], ...]
    """[i][j - i] for i <= j <= i + reach; for the exact centroid."""
    middles: tuple[Array, ...]
    """(a_i + c_i)/2 of the output terms."""
    grid: tuple[Array, Array, tuple[Array, ...]] | None
    """For the sampled centroid: points (P,), weights (P,), and of each output term its memberships
    (..., P)."""
    midrange: Array
    """Middle of the output range."""


def membership(x: Array, term: Slopes) -> Array:
    """Degree in [0, 1] to which x belongs to a triangular term.

    Both edges are measured from the peak, so a vertical edge (a huge but finite slope) gives 1 at
    the peak and 0 beyond it without a special case. The derivative at the peak is 0.
    """
    beyond = x - term.peak
    return maximum(1 - jnp.abs(beyond) * choose(beyond > 0, term.fall, term.rise), 0.0)


def slopes(a: Array, b: Array, c: Array) -> Slopes:
    """A term from its feet a, c and its peak b."""
    huge = 1 / jnp.finfo(b.dtype).tiny
    rise, fall = b - a, c - b
    # maximum(width, tiny) would still have a derivative by the width.
    return Slopes(
        b,
        choose(rise > 0, 1 / choose(rise > 0, rise, 1.0), huge),
        choose(fall > 0, 1 / choose(fall > 0, fall, 1.0), huge),
    )


def firing_heights(
    error: tuple[Array, ...], rate: tuple[Array, ...], rules: Rules, outputs: int
) -> Heights:
    """Height of each output term: the max over its rules of min(rate, error) memberships."""
    heights = []
    for output in range(outputs):
        fired = []
        for r, row in enumerate(rules):
            # min distributes over max, so the error terms of a row that lead to this output are
            # combined first.
            errors = [error[e] for e, target in enumerate(row) if target == output]
            if errors:
                fired.append(minimum(rate[r], reduce(maximum, errors)))
        heights.append(reduce(maximum, fired) if fired else jnp.zeros_like(error[0]))
    return tuple(heights)


def searched_heights(
    error: tuple[Array, ...], rate: tuple[Array, ...], targets: tuple[tuple[Array, ...], ...]
) -> Heights:
    """`firing_heights` for a rule table that is traced, because a search chooses it.

    The results are the same bit for bit, since minima and maxima cause no rounding. It is slower,
    because every rule is compared with every term.

    Args:
        error: memberships of the error in the n input terms.
        rate: memberships of the rate.
        targets: [rate][error] index of the output term, whole numbers from 0 to n - 1.
    """
    fired = [
        (target, minimum(of_rate, of_error))
        for of_rate, row in zip(rate, targets, strict=True)
        for of_error, target in zip(error, row, strict=True)
    ]
    nothing = jnp.zeros_like(error[0])
    return tuple(
        reduce(maximum, [choose(target == output, height, nothing) for target, height in fired])
        for output in range(len(error))
    )


def _overlap(bi: Array, ci: Array, aj: Array, bj: Array) -> Overlap:
    """The coefficients for terms i <= j, from the falling edge of i and the rising edge of j.

    At a height y their intersection reaches from aj + y u to ci - y v. The area up to h is the
    integral of that width over y, the first moment the integral of width times midpoint.
    """
    u, v, width = bj - aj, ci - bi, ci - aj
    slope = u + v
    ratio = width / choose(slope > 0, slope, 1.0)
    cap = choose(width > 0, choose(slope > 0, jnp.minimum(1.0, ratio), 1.0), 0.0)
    return Overlap(
        cap,
        (width, 0.5 * slope),
        (0.5 * width * (ci + aj), 0.5 * (ci * v + aj * u), slope * (v - u) / 6),
    )


def _integrals(overlap: Overlap, h: Array) -> tuple[Array, Array]:
    """Area and first moment of the intersection, clipped at a height h up to `overlap.cap`."""
    (f1, f2), (m1, m2, m3) = overlap.area, overlap.moment
    return h * (f1 - h * f2), h * (m1 - h * (m2 - h * m3))


def exact_integrals(
    heights: Heights, overlaps: tuple[tuple[Overlap, ...], ...]
) -> tuple[Array, Array]:
    """Area and first moment under the union of clipped, ordered terms, in closed form.

    Inclusion and exclusion, where only pairs matter: with m = min(h_i, h_j) and H the largest
    height strictly between i and j, terms i and j overlap above H without a term between them
    covering it: area = sum_i F_ii(h_i) - sum_{i<j} [F_ij(m) - F_ij(min(m, H))].
    """
    area = jnp.zeros_like(heights[0])
    moment = jnp.zeros_like(heights[0])
    for i, (alone, *pairs) in enumerate(overlaps):
        # A single term reaches 1 (or has no width, and coefficients of 0), so the minimum changes
        # no value; at the top of a vertical edge it stops the derivative.
        f, m = _integrals(alone, minimum(heights[i], 1.0))
        area, moment = area + f, moment + m
        between = None
        for j, overlap in enumerate(pairs, start=i + 1):
            low = minimum(minimum(heights[i], heights[j]), overlap.cap)
            f, m = _integrals(overlap, low)
            area, moment = area - f, moment - m
            if between is not None:
                f, m = _integrals(overlap, minimum(low, between))
                area, moment = area + f, moment + m
            between = heights[j] if between is None else maximum(between, heights[j])
    return area, moment


def sampled_integrals(
    heights: Heights, grid: tuple[Array, Array, tuple[Array, ...]]
) -> tuple[Array, Array]:
    """Area and first moment of the aggregated membership by sums over sample points."""
    # Sample points are appended as the last axis.
    ranks = heights[0].ndim + 1
    points, weights, *memberships = (
        jnp.reshape(a, (1,) * (ranks - a.ndim) + a.shape) for a in (*grid[:2], *grid[2])
    )
    clipped = [jnp.minimum(h[..., None], m) for h, m in zip(heights, memberships, strict=True)]
    weighted = weights * reduce(jnp.maximum, clipped)
    return jnp.sum(weighted, axis=-1), jnp.sum(weighted * points, axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FuzzyController:
    """A Mamdani controller: gain K = offset + centroid from an error and its rate, both in [0, 1].

    An output term without width (k12 = 0) has no area. If only such terms fire, the gain is their
    limit; as soon as any other term fires, however weakly, they do not count, and the gain jumps.
    This makes one point sensitive to rounding: at the foot of an input term the membership is 0,
    but a fused multiply-add may leave 1e-17. There (a foot at 0, k2 = 0, and a rate of 0) a
    compiled program may return the other term's gain, and the exported C the limit. If all output
    terms have some width, both agree to rounding.

    Args:
        input_terms: (n, 3) feet and peak [a, b, c] of the input terms, shared by error and rate.
        output_terms: (m, 3) the same for the output terms [1/s].
        rules: n rows (rate) of n output term indices (error), both from small to large.
        output_range: ends of the output universe [1/s], for the sampled centroid's grid and for
            the mid-range.
        centroid: "exact" (closed form; needs ordered terms) or "sampled".
        sampled_points: number of sample points of the sampled centroid, ends included.
        sampled_rule: "sum" (MATLAB's) or "trapezoid".
        no_rule: gain where no rule fires, "hold" the last one or "midrange" of the output
            (MATLAB's).
        reach: output terms i and j overlap only if `|i - j| <= reach`, if known. The exact
            centroid then skips the other pairs, which makes it faster and changes no result.
        offset: added to the centroid [1/s], at least 0; 1 in the paper.

    Raises:
        FuzzyError: shapes, order, rules or reach do not fit. Checked outside jit only; inside, the
            mapping from a search vector (`search.parameters`) ensures it.
    """

    input_terms: Array
    output_terms: Array
    rules: Rules = field(metadata={"static": True})
    output_range: tuple[float, float] = field(metadata={"static": True})
    centroid: Centroid = field(default="exact", metadata={"static": True})
    sampled_points: int = field(default=101, metadata={"static": True})
    sampled_rule: SampledRule = field(default="sum", metadata={"static": True})
    no_rule: NoRule = field(default="hold", metadata={"static": True})
    reach: int | None = field(default=None, metadata={"static": True})
    offset: float = field(default=1.0, metadata={"static": True})

    def __post_init__(self) -> None:
        given = (self.input_terms, self.output_terms)
        if not all(isinstance(a, np.ndarray | list | tuple) or _is_concrete(a) for a in given):
            return  # traced, or a placeholder of a tree transformation
        try:
            for name, terms in zip(("input_terms", "output_terms"), given, strict=True):
                floating = isinstance(terms, Array) and jnp.issubdtype(terms.dtype, jnp.floating)
                if not floating:
                    object.__setattr__(self, name, jnp.asarray(np.asarray(terms, np.float64)))
        except (TypeError, ValueError) as error:
            raise FuzzyError(f"{name}: must be an array of numbers ({error})") from None
        _check(self)

    def prepare(self) -> PreparedController:
        """Everything that does not depend on the inputs, computed before a loop."""
        a, b, c = (self.input_terms[..., i] for i in range(3))
        inputs = tuple(slopes(a[..., i], b[..., i], c[..., i]) for i in range(a.shape[-1]))
        out = self.output_terms
        triangles = [tuple(out[..., i, k] for k in range(3)) for i in range(out.shape[-2])]
        overlaps: tuple[tuple[Overlap, ...], ...] = ()
        grid = None
        if self.centroid == "exact":
            reach = len(triangles) if self.reach is None else self.reach
            overlaps = tuple(
                tuple(_overlap(bi, ci, aj, bj) for aj, bj, _ in triangles[i : i + reach + 1])
                for i, (_, bi, ci) in enumerate(triangles)
            )
        else:
            points = jnp.linspace(*self.output_range, self.sampled_points, dtype=out.dtype)
            weights = jnp.ones_like(points)
            if self.sampled_rule == "trapezoid":
                weights = weights.at[jnp.array([0, -1])].set(0.5)
            at = jnp.reshape(points, (1,) * (out.ndim - 2) + points.shape)
            each = ((t[..., None] for t in triangle) for triangle in triangles)
            grid = (points, weights, tuple(membership(at, slopes(*one)) for one in each))
        low, high = self.output_range
        return PreparedController(
            inputs=inputs,
            overlaps=overlaps,
            middles=tuple(0.5 * (t[0] + t[2]) for t in triangles),
            grid=grid,
            midrange=jnp.asarray(0.5 * (low + high), out.dtype),
        )

    def heights(
        self, error: Array, rate: Array, prepared: PreparedController | None = None
    ) -> Heights:
        """Firing height of each output term, in the shape of the inputs."""
        prepared = self.prepare() if prepared is None else prepared
        of_error = tuple(membership(error, term) for term in prepared.inputs)
        of_rate = tuple(membership(rate, term) for term in prepared.inputs)
        return firing_heights(of_error, of_rate, self.rules, len(prepared.middles))

    def defuzzify(self, heights: Heights, prepared: PreparedController, last: Array) -> Array:
        """Gain K = offset + centroid of the terms clipped at the heights; never NaN.

        Args:
            heights: one array for each output term.
            prepared: from `prepare`.
            last: the last gain [1/s], returned where no rule fires if `no_rule` is "hold".
        """
        tallest = reduce(maximum, heights)
        fires = tallest > 0
        safe = choose(fires, tallest, 1.0)
        # Heights so low that areas would underflow are scaled up: only their ratios matter then.
        lift = maximum(0.1 * jnp.finfo(tallest.dtype).eps / safe, 1.0)
        heights = tuple(lift * h for h in heights)
        if prepared.grid is None:
            area, moment = exact_integrals(heights, prepared.overlaps)
        else:
            area, moment = sampled_integrals(heights, prepared.grid)
        # If rules fire but the area is 0, all firing terms have zero width. The limit is that of
        # equally narrow terms, each with the area h (2 - h)/2 in units of its width.
        regular = area > jnp.finfo(area.dtype).tiny
        spikes = [h * (2 - h) for h in heights]
        spike_area = sum(spikes)
        spike_moment = sum(s * x for s, x in zip(spikes, prepared.middles, strict=True))
        area = choose(regular, area, choose(fires, spike_area, 1.0))
        moment = choose(regular, moment, spike_moment)
        idle = last if self.no_rule == "hold" else self.offset + prepared.midrange
        return choose(fires, self.offset + moment / area, idle)

    @property
    def middle_gain(self) -> float:
        """The gain in the middle of the output range [1/s], in double precision."""
        low, high = map(float, self.output_range)
        return self.offset + 0.5 * (low + high)

    def initial_gain(self) -> Array:
        """The gain before any rule has fired: the middle of the output range [1/s]."""
        return jnp.asarray(self.middle_gain, self.output_terms.dtype)

    def __call__(self, error: ArrayLike, rate: ArrayLike, last: ArrayLike | None = None) -> Array:
        """The gain K [1/s] for errors and rates.

        Args:
            error: scaled error, any shape; clipped to [0, 1].
            rate: scaled rate of the error per sample, same shape; clipped to [0, 1].
            last: last gain [1/s], returned where no rule fires if `no_rule` is "hold"; by default
                the middle of the range.

        Returns:
            The gains. Where an input is NaN the gain is NaN; inside jit it is the gain without a
            firing rule, because there a NaN input means that the estimate is NaN already.
        """
        with fitting("FuzzyController: error, rate, last"):
            if any(isinstance(a, Tracer) for a in (*jax.tree.leaves(self), error, rate, last)):
                return self._gain(error, rate, last)
            given = (
                a if a is None or isinstance(a, Array) else np.asarray(a)
                for a in (error, rate, last)
            )
            return _compiled_gain(self, *given)

    def _gain(self, error: ArrayLike, rate: ArrayLike, last: ArrayLike | None) -> Array:
        """The gains, in operations that can be traced."""
        dtype = self.output_terms.dtype
        e, r = (jnp.clip(jnp.asarray(x, dtype), 0.0, 1.0) for x in (error, rate))
        e, r = jnp.broadcast_arrays(e, r)
        held = self.initial_gain() if last is None else jnp.asarray(last, dtype)
        prepared = self.prepare()
        return self.defuzzify(
            self.heights(e, r, prepared), prepared, jnp.broadcast_to(held, e.shape)
        )

    def surface(self, resolution: int = 101) -> tuple[Array, Array, Array]:
        """Control surface: errors (r,), rates (r,) and gains (rate, error) [1/s] on [0, 1]^2."""
        axis = jnp.linspace(0.0, 1.0, resolution, dtype=self.output_terms.dtype)
        return axis, axis, gains_over(self, axis)


@jax.jit
def _compiled_gain(
    controller: FuzzyController, error: ArrayLike, rate: ArrayLike, last: ArrayLike | None
) -> Array:
    """The gains for a call from outside jit, which without compilation would take 35 ms."""
    gain = controller._gain(error, rate, last)
    unknown = jnp.isnan(jnp.asarray(error)) | jnp.isnan(jnp.asarray(rate))
    return jnp.where(unknown, jnp.asarray(jnp.nan, gain.dtype), gain)


@jax.jit
def gains_over(controller: FuzzyController, axis: ArrayLike) -> Array:
    """Gains (rate, error) [1/s] on an axis (r,) of both, compiled once for all of a structure."""
    # Row by row, because the sampled centroid needs all its points in memory for each input.
    return jax.lax.map(lambda rate: controller(axis, jnp.full_like(axis, rate)), axis)


def _is_concrete(a: object) -> bool:
    return isinstance(a, Array) and not isinstance(a, Tracer)


def _float64(values: tuple) -> np.ndarray:
    """The values as an array, NaN for those that are not numbers."""
    numbers = [v if isinstance(v, Real) and not isinstance(v, bool) else np.nan for v in values]
    return np.array(numbers, np.float64)


def _check(controller: FuzzyController) -> None:
    """Raise FuzzyError if the controller cannot be evaluated."""
    for name in ("input_terms", "output_terms"):
        terms = np.asarray(getattr(controller, name))
        if terms.ndim < 2 or terms.shape[-1] != 3 or terms.shape[-2] < 1:
            raise FuzzyError(
                f"{name}: must have the shape (terms, 3) of feet and peaks, got {terms.shape}"
            )
        if not np.isfinite(terms).all():
            raise FuzzyError(f"{name}: must be finite, got {terms.tolist()}")
        if controller.centroid == "exact":
            if (np.diff(terms, axis=-1) < 0).any():
                raise FuzzyError(
                    f"{name}: each term must ascend, a <= b <= c, got {terms.tolist()}"
                )
            if (np.diff(terms, axis=-2) < 0).any():
                raise FuzzyError(
                    f"{name}: the a's, b's and c's must each ascend from term to term for the "
                    f'exact centroid (centroid="sampled" takes any order), got {terms.tolist()}'
                )
    inputs, outputs = np.shape(controller.input_terms)[-2], np.shape(controller.output_terms)[-2]
    if controller.centroid == "exact":
        _check_reach(controller)
    rules = controller.rules
    if not isinstance(rules, tuple) or not all(isinstance(row, tuple) for row in rules):
        raise FuzzyError(f"rules: must be a tuple of tuples of output terms, got {rules!r}")
    if len(rules) != inputs or any(len(row) != inputs for row in rules):
        raise FuzzyError(f"rules: must be {inputs} rows of {inputs} output terms, got {rules}")
    if not all(isinstance(t, int) and 0 <= t < outputs for row in rules for t in row):
        raise FuzzyError(f"rules: entries must be output terms 0 to {outputs - 1}, got {rules}")
    for name, kind in (("centroid", Centroid), ("sampled_rule", SampledRule), ("no_rule", NoRule)):
        if getattr(controller, name) not in get_args(kind):
            allowed = " or ".join(map(repr, get_args(kind)))
            raise FuzzyError(f"{name}: must be {allowed}, got {getattr(controller, name)!r}")
    if not (_float64((controller.offset,)) >= 0).all() or controller.offset == np.inf:
        raise FuzzyError(
            f"offset: must be a finite number of at least 0, got {controller.offset!r}"
        )
    points, ends = controller.sampled_points, controller.output_range
    if not isinstance(points, int) or points < 2:
        raise FuzzyError(f"sampled_points: must be at least 2, got {points!r}")
    if not (isinstance(ends, tuple) and len(ends) == 2 and np.isfinite(_float64(ends)).all()):
        raise FuzzyError(f"output_range: must be a tuple of two finite numbers, got {ends!r}")
    if not ends[0] < ends[1]:
        raise FuzzyError(f"output_range: must ascend, got {controller.output_range}")


def _check_reach(controller: FuzzyController) -> None:
    """Raise FuzzyError if the reach is less than that of the overlaps."""
    reach = controller.reach
    if reach is None:
        return
    if isinstance(reach, bool) or not isinstance(reach, int) or reach < 0:
        raise FuzzyError(f"reach: must be a whole number from 0, or None, got {reach!r}")
    terms = np.asarray(controller.output_terms)
    apart = reach + 1
    if (terms[..., :-apart, 2] > terms[..., apart:, 0]).any():
        raise FuzzyError(
            f"reach: must not be {reach}, as output terms {apart} apart overlap: {terms.tolist()}"
        )
