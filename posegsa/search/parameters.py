"""The searched parameters k1 to k22: their boxes, their repair, and the controller of a vector.

The vector k fills the feet and peaks of the paper's terms (Eqs. 18 and 19):
    input terms   [0, 0, k1]  [k2, k3, k4]     [k5, k6, k7]     [k8, k9, k10]    [k11, 1, 1]
    output terms  [0, 0, k12] [k13, k14, k15]  [k16, k17, k18]  [k19, k20, k21]  [k22, 100, 100]
The boxes don't keep the k's in order: 93 % of random draws have a triangle out of order, and 73 %
leave gaps in which no rule fires. Two repairs fix that; each can be switched off. Both keep every
value inside its own box, and don't change a vector that is already in order and without gaps.

If the rule table is searched too, 25 further numbers in [0, 5] follow the k's, row by row: a row
for each term of the rate, from small to large. The integer part of each number is the output term
of its rule (5 counts as 4), so all terms have the same share of the box.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from posegsa.config import INPUT_RANGE, PARAMETERS, TERMS, triangles
from posegsa.errors import FuzzyError
from posegsa.model.elementwise import choose
from posegsa.model.fuzzy import Centroid, FuzzyController, NoRule, Rules, SampledRule
from posegsa.model.schedules import FuzzyGain, SearchedRulesGain

INPUT_COUNT, K_COUNT = len(PARAMETERS) // 2, len(PARAMETERS)
"""Number of k's that shape the input terms, and number of all k's."""
TERM_COUNT = len(TERMS)
RULES = TERM_COUNT**2
"""Number of rules in the table."""

_SEARCHED = slice(2, 13)
"""The searched values among the 15 entries of five triangles; the other four are fixed."""

_STATIC = {"static": True}
"""Marks a static field: programs are compiled for its value."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ParameterSpace:
    """Boxes and repairs of a search vector, and the controller's settings that are not searched.

    A vector has d numbers: k1 to k22, then those of the rules if they are searched.
    """

    lower: Array
    """(d,)"""
    upper: Array
    """(d,)"""
    overlap: Array
    """Minimum overlap of neighbouring input terms after the coverage repair, on [0, 1]."""
    ordering: bool = field(metadata=_STATIC)
    coverage: bool = field(metadata=_STATIC)
    rules: Rules | None = field(metadata=_STATIC)
    """The rule table; None if it is searched."""
    gain_range: tuple[float, float] = field(metadata=_STATIC)
    """Ends of the output universe [1/s]."""
    centroid: Centroid = field(metadata=_STATIC)
    sampled_points: int = field(metadata=_STATIC)
    sampled_rule: SampledRule = field(metadata=_STATIC)
    no_rule: NoRule = field(metadata=_STATIC)
    reach: int = field(metadata=_STATIC)
    """Largest distance in order of two output terms that can overlap within the boxes."""
    offset: float = field(default=1.0, metadata=_STATIC)
    """Added to the controller's output [1/s]."""

    def terms(self, k: Array) -> tuple[Array, Array]:
        """Input and output terms (5, 3) of a vector (d,), repaired as configured."""
        return _terms(self, k)  # compiled as one program when called outside jit

    def raw_terms(self, k: Array) -> tuple[Array, Array]:
        """Input and output terms (5, 3) of a vector (d,) as it stands, without any repair."""
        inputs, outputs = self._triangles(k)
        return _stacked(inputs), _stacked(outputs)

    def _triangles(self, k: Array) -> tuple[list[list[Array]], list[list[Array]]]:
        """`raw_terms`, as lists of scalars."""

        def terms(searched: Array, ends: tuple[float, float]) -> list[list[Array]]:
            low, high = (jnp.asarray(end, k.dtype) for end in ends)
            return [list(triangle) for triangle in triangles(tuple(searched), low, high)]

        return terms(k[:INPUT_COUNT], INPUT_RANGE), terms(k[INPUT_COUNT:K_COUNT], self.gain_range)

    def controller(self, k: Array) -> FuzzyController:
        """The controller of a vector (d,); only outside jit if the rules are searched."""
        return self._controller(k, self.rules or _table(rule_targets(k)))

    def _controller(self, k: Array, rules: Rules) -> FuzzyController:
        inputs, outputs = self.terms(k)
        return FuzzyController(
            input_terms=inputs,
            output_terms=outputs,
            rules=rules,
            output_range=self.gain_range,
            centroid=self.centroid,
            sampled_points=self.sampled_points,
            sampled_rule=self.sampled_rule,
            no_rule=self.no_rule,
            reach=self.reach,
            offset=self.offset,
        )

    def schedule(self, vector: Array) -> FuzzyGain:
        """The gain schedule of a vector (d,).

        Inside jit, searched rules are arrays of the schedule; outside, they are a rule table.
        """
        if self.rules is None and isinstance(vector, Tracer):
            return SearchedRulesGain(self._controller(vector, NO_RULES), rule_targets(vector))
        return FuzzyGain(self.controller(vector))

    def vector(self, controller: FuzzyController) -> Array:
        """The vector (d,) of a controller, the inverse of `controller` on repaired vectors.

        Searched rules get the middle of their term's share of the box.
        """
        terms = controller.input_terms, controller.output_terms
        parts = [jnp.reshape(t, 15)[_SEARCHED] for t in terms]
        if self.rules is None:
            parts.append(jnp.asarray(controller.rules, self.lower.dtype).reshape(RULES) + 0.5)
        return jnp.concatenate(parts)

    def valid(self, vector: Array) -> Array:
        """Whether a vector (d,) has a cost: with ordering off, only if it is in order."""
        if self.ordering:
            return jnp.asarray(True)
        return jnp.all(jnp.stack([in_order(t) for t in self.raw_terms(vector)]))

    def checked(self, k: ArrayLike) -> Array:
        """A vector from a user, as an array (d,) of the space's dtype.

        Raises:
            FuzzyError: The vector has a wrong length, is not finite, or is outside the boxes.
        """
        count, what = self.lower.shape[0], "k1 to k22"
        if self.rules is None:
            what += f" and {RULES} of the rules"
        try:
            values = np.asarray(k, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise FuzzyError(f"k: must be {count} numbers, {what} ({error})") from None
        if values.shape != (count,):
            raise FuzzyError(f"k: must have the shape ({count},), {what}, got {values.shape}")
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        slack = 1e-6 * np.maximum(1.0, np.abs(upper))  # rounding of float32 results written as text
        inside = (lower - slack <= values) & (values <= upper + slack)
        for i in np.flatnonzero(~inside):
            allowed = f"[{lower[i]:g}, {upper[i]:g}]"
            name = PARAMETERS[i] if i < K_COUNT else f"rule {i - K_COUNT + 1}"
            raise FuzzyError(f"{name}: must lie in {allowed}, got {values[i]:g}")
        return jnp.asarray(np.clip(values, lower, upper), self.lower.dtype)


NO_RULES: Rules = ((0,) * TERM_COUNT,) * TERM_COUNT
"""Placeholder table of a controller whose rules are given separately."""


@jax.jit
def _terms(space: ParameterSpace, k: Array) -> tuple[Array, Array]:
    # Scalars, not arrays: XLA:CPU may fuse a small search into one function, and then computes the
    # inputs of a concatenation again for each use. The code grows by three for each exchange in a
    # row; it took minutes to compile.
    both = space._triangles(k)
    if space.ordering:
        both = [_in_order(terms) for terms in both]
    inputs, outputs = map(_stacked, both)
    if space.coverage:
        lower_inputs, _ = space.raw_terms(space.lower)
        inputs = covering(inputs, lower_inputs[:, 0], space.overlap)
    return inputs, outputs


def rule_targets(vector: Array) -> Array:
    """The output terms (5, 5) of the rules, [rate, error], of a vector with searched rules."""
    terms = jnp.clip(jnp.floor(vector[K_COUNT:]), 0.0, TERM_COUNT - 1.0)
    return terms.reshape(TERM_COUNT, TERM_COUNT)


def _table(targets: Array) -> Rules:
    return tuple(tuple(int(target) for target in row) for row in np.asarray(targets))


def _in_order(terms: list[list[Array]]) -> list[list[Array]]:
    """Terms with each triangle sorted, then the a's, the b's and the c's across terms.

    The second sort keeps the first: sorting the columns of a matrix with ascending rows keeps the
    rows ascending.
    """
    columns = zip(*map(_sorted, terms), strict=True)
    return [list(row) for row in zip(*(_sorted(list(column)) for column in columns), strict=True)]


def _stacked(terms: list[list[Array]]) -> Array:
    """Terms (..., 5, 3) from lists of arrays (...)."""
    return jnp.stack([jnp.stack(triangle, axis=-1) for triangle in terms], axis=-2)


_EXCHANGES = {
    3: ((0, 2), (0, 1), (1, 2)),
    5: ((0, 3), (1, 4), (0, 2), (1, 3), (0, 1), (2, 4), (1, 2), (3, 4), (2, 3)),
}
"""Sorting networks: pairs of indices, in order, whose values are exchanged if the first is larger
(D. E. Knuth, "The Art of Computer Programming", volume 3, section 5.3.4). XLA:CPU's sort of so few
numbers takes fifty times as long, 0.2 ms for the terms of 100 agents."""


def _sorted(values: list[Array]) -> list[Array]:
    """Arrays of one shape, sorted in ascending order element by element."""
    for i, j in _EXCHANGES[len(values)]:
        a, b = values[i], values[j]
        exchange = a > b
        values[i], values[j] = choose(exchange, b, a), choose(exchange, a, b)
    return values


def covering(terms: Array, lower_feet: Array, overlap: Array) -> Array:
    """Input terms (5, 3) without gaps: a_{i+1} <- max(low, a_i, min(a_{i+1}, c_i - overlap)).

    The terms must be ordered; lower_feet (5,) are the lower bounds of the a's. A lower bound above
    c_i - overlap has priority, so the result stays in its box.
    """
    feet = [terms[0, 0]]
    for i in range(terms.shape[0] - 1):
        moved = jnp.minimum(terms[i + 1, 0], terms[i, 2] - overlap)
        feet.append(jnp.maximum(jnp.maximum(lower_feet[i + 1], feet[i]), moved))
    return terms.at[:, 0].set(jnp.stack(feet))


def in_order(terms: Array) -> Array:
    """Whether each triangle ascends and the a's, b's and c's ascend from term to term."""
    return jnp.all(jnp.diff(terms, axis=1) >= 0) & jnp.all(jnp.diff(terms, axis=0) >= 0)
