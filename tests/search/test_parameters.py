"""From a vector k1 to k22 to terms: repairs against the reference, and their properties."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.controllers import RULES, corner_vectors, search_vectors
from helpers.experiments import PAPER, space

from posegsa.config import triangles
from posegsa.errors import FuzzyError
from posegsa.model.fuzzy import (
    FuzzyController,
    firing_heights,
    membership,
    searched_heights,
    slopes,
)
from posegsa.model.schedules import FuzzyGain, ScheduleInputs, SearchedRulesGain
from posegsa.search.parameters import ParameterSpace
from posegsa.search.search_spaces import rule_indices

pytestmark = pytest.mark.optimised

KINDS = [search_vectors, corner_vectors]
COUNT = 500
"""Number of vectors repaired at once; always the same, so that one program is compiled."""
REPAIRS = {
    "both": ((), (True, True)),
    "order": (("fuzzy.coverage=false",), (True, False)),
    "none": (
        ("fuzzy.coverage=false", "fuzzy.ordering=false", "fuzzy.centroid=sampled"),
        (False, False),
    ),
}


def all_terms(made: ParameterSpace, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Terms (count, 5, 3) of vectors (count, 22)."""
    inputs, outputs = terms_of(made, jnp.asarray(vectors, made.lower.dtype))
    return np.asarray(inputs), np.asarray(outputs)


@jax.jit
def terms_of(made: ParameterSpace, vectors: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(made.terms)(vectors)


@jax.jit
def read_back(made: ParameterSpace, vectors: jax.Array) -> jax.Array:
    return jax.vmap(lambda k: made.vector(made.controller(k)))(vectors)


def as_vectors(made: ParameterSpace, vectors: np.ndarray) -> np.ndarray:
    """Vectors (count, 22) that are read back from their controllers."""
    return np.asarray(read_back(made, jnp.asarray(vectors, made.lower.dtype)))


def in_order(terms: np.ndarray) -> np.ndarray:
    """Whether the triangles of each of terms (count, 5, 3) are sorted, within and across terms."""
    return (np.diff(terms, axis=2) >= 0).all((1, 2)) & (np.diff(terms, axis=1) >= 0).all((1, 2))


@jax.jit
def validity_of(made: ParameterSpace, vectors: jax.Array) -> jax.Array:
    return jax.vmap(made.valid)(vectors)


def valid(made: ParameterSpace, vectors: np.ndarray) -> np.ndarray:
    """Whether each vector of (count, 22) has a cost."""
    return np.asarray(validity_of(made, jnp.asarray(vectors, made.lower.dtype)))


# Repairs ------------------------------------------------------------------------------------------


@pytest.mark.quick
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", KINDS)
@pytest.mark.parametrize(("changes", "repairs"), REPAIRS.values(), ids=REPAIRS.keys())
def test_terms_against_the_reference(
    changes: tuple[str, ...], repairs: tuple[bool, bool], vectors: Callable[[int], np.ndarray]
) -> None:
    drawn = vectors(COUNT)
    low, high = reference.PAPER_LOWER, reference.PAPER_UPPER
    expected = [reference.repair(k, low, high, *repairs) for k in drawn]
    for terms, theirs in zip(
        all_terms(space(*changes), drawn), zip(*expected, strict=True), strict=True
    ):
        np.testing.assert_array_equal(terms, theirs)  # nothing but comparisons and one subtraction


@pytest.mark.usefixtures("x64")
def test_the_papers_boxes_and_overlap_are_the_configured_ones() -> None:
    made = space()
    np.testing.assert_array_equal(made.lower, reference.PAPER_LOWER)
    np.testing.assert_array_equal(made.upper, reference.PAPER_UPPER)
    assert made.overlap == 0.01
    assert made.rules == RULES == rule_indices(PAPER.fuzzy.rules)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("overlap", [0.0, 0.03])
def test_another_overlap_against_the_reference(overlap: float) -> None:
    drawn, low, high = search_vectors(COUNT), reference.PAPER_LOWER, reference.PAPER_UPPER
    inputs, _ = all_terms(space(f"fuzzy.overlap={overlap}"), drawn)
    expected = [reference.repair(k, low, high, overlap=overlap)[0] for k in drawn]
    np.testing.assert_array_equal(inputs, expected)


@pytest.mark.quick
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("vectors", KINDS)
def test_repaired_values_stay_in_their_own_boxes(
    vectors: Callable[[int], np.ndarray], dtype: str
) -> None:
    with jax.enable_x64(dtype == "float64"):
        made = space(dtype=dtype)
        # Rounded to the dtype first, like the vectors of a search.
        lower, upper = np.asarray(made.lower), np.asarray(made.upper)
        drawn = np.clip(vectors(COUNT).astype(dtype), lower, upper)
        repaired = as_vectors(made, drawn)
        assert (repaired >= lower).all()
        assert (repaired <= upper).all()
        assert (repaired != drawn).any(axis=1).mean() > 0.9  # most need repair


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("vectors", KINDS)
def test_repairing_twice_changes_nothing(vectors: Callable[[int], np.ndarray], dtype: str) -> None:
    with jax.enable_x64(dtype == "float64"):
        made = space(dtype=dtype)
        once = as_vectors(made, vectors(COUNT))
        np.testing.assert_array_equal(as_vectors(made, once), once)
        for terms, again in zip(
            all_terms(made, vectors(COUNT)), all_terms(made, once), strict=True
        ):
            np.testing.assert_array_equal(again, terms)
        for terms in all_terms(made, once):
            assert in_order(terms).all()


def gaps(terms: np.ndarray) -> np.ndarray:
    """Whether somewhere on [0, 1] no input term fires, for terms (count, 5, 3)."""
    return np.asarray(gaps_of(jnp.asarray(terms)))


@jax.jit
def gaps_of(terms: jax.Array) -> jax.Array:
    x = jnp.linspace(0, 1, 4001)

    def of(triangles: jax.Array) -> jax.Array:
        each = [membership(x, slopes(*t)) for t in triangles]
        return jnp.any(jnp.max(jnp.stack(each), axis=0) <= 0)

    return jax.vmap(of)(terms)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", KINDS)
def test_coverage_leaves_no_gap(vectors: Callable[[int], np.ndarray]) -> None:
    inputs, _ = all_terms(space(), vectors(COUNT))
    assert not gaps(inputs).any()
    # The overlap is 0.01 where the boxes allow it. The paper's boxes don't allow it if the right
    # foot of VS is below 0.01 (S can't start below 0) or that of M below 0.11 (L can't start below
    # 0.1). The terms then overlap less, still without a gap.
    overlap = inputs[:, :4, 2] - inputs[:, 1:, 0]
    low = np.array([reference.PAPER_LOWER[i] for i in (1, 4, 7, 10)])
    wanted = np.minimum(0.01, inputs[:, :4, 2] - low)
    assert (overlap >= wanted - 1e-15).all()
    assert (overlap >= 0).all()


@pytest.mark.usefixtures("x64")
def test_without_coverage_most_vectors_leave_gaps() -> None:
    inputs, _ = all_terms(space(*REPAIRS["order"][0]), search_vectors(COUNT))
    assert gaps(inputs).mean() == pytest.approx(0.73, abs=0.03)


def primitives(jaxpr: Any) -> Iterator[str]:
    """Names of a program's primitives in order, including those of the programs that it calls."""
    for equation in jaxpr.eqns:
        yield equation.primitive.name
        called = equation.params.get("jaxpr")
        if called is not None:
            yield from primitives(called.jaxpr)


def test_numbers_are_joined_only_once_they_are_in_order() -> None:
    """Otherwise XLA:CPU takes minutes and gigabytes to compile a random search of six agents."""
    k = jnp.zeros(22, jnp.float32)
    made = space(*REPAIRS["order"][0], dtype="float32")
    done = list(primitives(jax.make_jaxpr(made.terms)(k).jaxpr))
    joined = min(i for i, name in enumerate(done) if name in ("stack", "concatenate"))
    assert "select_n" not in done[joined:]
    assert done.count("select_n") == 2 * 2 * (5 * 3 + 3 * 9), "two for each exchange"


@pytest.mark.usefixtures("x64")
def test_most_vectors_are_out_of_order_as_drawn() -> None:
    made, drawn = space(*REPAIRS["none"][0]), search_vectors(COUNT)
    inputs, outputs = all_terms(made, drawn)  # nothing is repaired
    assert 1 - in_order(inputs).mean() == pytest.approx(0.98, abs=0.02)
    triangles = (np.diff(inputs, axis=2) >= 0).all(axis=(1, 2))
    assert 1 - triangles.mean() == pytest.approx(0.93, abs=0.02)
    np.testing.assert_array_equal(valid(made, drawn), in_order(inputs) & in_order(outputs))


@pytest.mark.usefixtures("x64")
def test_validity_with_ordering_off_is_order_and_with_it_on_everything() -> None:
    low, high = reference.PAPER_LOWER, reference.PAPER_UPPER
    in_its_order = as_vectors(space(), search_vectors(COUNT))[0]
    swapped = in_its_order.copy()
    swapped[[12, 13]] = [9.0, 3.0]  # k13 > k14: the foot of a term beyond its peak
    assert (swapped >= low).all()
    assert (swapped <= high).all()
    both = np.resize([in_its_order, swapped], (COUNT, 22))
    assert valid(space(*REPAIRS["none"][0]), both).tolist() == [True, False] * (COUNT // 2)
    assert bool(space().valid(jnp.asarray(swapped)))


# Overlap of output terms --------------------------------------------------------------------------


def boxes(lower: np.ndarray, upper: np.ndarray) -> ParameterSpace:
    """The paper's space with other boxes of the output terms, k12 to k22."""
    low, high = (
        np.concatenate([ours[:11], of_outputs]).tolist()
        for ours, of_outputs in (
            (reference.PAPER_LOWER, lower),
            (reference.PAPER_UPPER, upper),
        )
    )
    return space(f"parameters.lower={low}", f"parameters.upper={high}")


@pytest.mark.usefixtures("x64")
def test_terms_reach_two_on_in_the_papers_boxes_and_anywhere_in_wide_ones() -> None:
    assert space().reach == 2
    assert boxes(np.zeros(11), np.full(11, 100.0)).reach == 4
    assert boxes(np.zeros(11), np.zeros(11)).reach == 0  # all terms but the last at 0


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("seed", range(10))
def test_no_vector_in_its_boxes_reaches_further(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width = rng.uniform(0, 30)
    ends = np.stack([lower := rng.uniform(0, 100 - width, 11), lower + width * rng.random(11)])
    # Sorted like the terms, as the bounds of a configuration must be in order.
    ordered = [
        np.ravel(np.sort(np.sort(triangles(tuple(end), 0.0, 100.0), axis=1), axis=0))[2:13]
        for end in ends
    ]
    made = boxes(*ordered)
    drawn = rng.uniform(made.lower, made.upper, (500, 22))
    drawn[:250] = np.where(rng.random((250, 22)) < 0.5, made.lower, made.upper)
    _, outputs = all_terms(made, drawn)
    i, j = np.triu_indices(5)
    overlap = outputs[:, i, 2] > outputs[:, j, 0]
    assert not overlap[:, j - i > made.reach].any()


def test_leaving_out_terms_that_do_not_meet_changes_no_bit() -> None:
    made = space(dtype="float32")
    drawn = np.concatenate([kind(200) for kind in KINDS]).astype(np.float32)
    error, rate = np.random.default_rng(0).random((2, 400)).astype(np.float32)

    def gains(reach: int | None) -> np.ndarray:
        def gain(k: jax.Array, e: jax.Array, r: jax.Array) -> jax.Array:
            return dataclasses.replace(made.controller(k), reach=reach)(e, r)

        return np.asarray(jax.jit(jax.vmap(gain))(drawn, error, rate))

    np.testing.assert_array_equal(gains(made.reach), gains(None))


# Vectors and controllers --------------------------------------------------------------------------


def test_a_controller_has_the_configured_choices() -> None:
    changes = ("fuzzy.centroid=sampled", "fuzzy.sampled_points=51", "fuzzy.sampled_rule=trapezoid")
    made = space(*changes, "fuzzy.no_rule=midrange", dtype="float32")
    controller = jax.eval_shape(made.controller, jnp.asarray(search_vectors(1)[0], jnp.float32))
    assert (controller.centroid, controller.sampled_points) == ("sampled", 51)
    assert (controller.sampled_rule, controller.no_rule) == ("trapezoid", "midrange")
    assert controller.rules == RULES
    assert controller.output_range == (0, 100)
    assert controller.input_terms.dtype == jnp.float32


@pytest.mark.usefixtures("x64")
def test_the_vector_fills_the_terms_in_the_papers_order() -> None:
    inputs, outputs = space().raw_terms(jnp.arange(1.0, 23.0))
    np.testing.assert_array_equal(inputs, [[0, 0, 1], [2, 3, 4], [5, 6, 7], [8, 9, 10], [11, 1, 1]])
    np.testing.assert_array_equal(
        outputs, [[0, 0, 12], [13, 14, 15], [16, 17, 18], [19, 20, 21], [22, 100, 100]]
    )


def test_the_gain_range_bounds_the_output_terms() -> None:
    made = space(dtype="float32")
    made = dataclasses.replace(made, gain_range=(2.0, 90.0))
    _, outputs = made.raw_terms(jnp.full(22, 50.0))
    assert (outputs[0, 0], outputs[0, 1], outputs[4, 1], outputs[4, 2]) == (2, 2, 90, 90)


def test_checked_takes_what_a_result_file_holds() -> None:
    made = space(dtype="float32")
    k = search_vectors(1)[0]
    checked = made.checked(k.tolist())
    assert checked.dtype == jnp.float32
    np.testing.assert_allclose(checked, k, rtol=1e-7)
    # Bounds printed with 7 digits differ by a rounding error and are accepted.
    for bound in (made.lower, made.upper):
        made.checked([float(f"{x:.7g}") for x in np.asarray(bound)])


def replaced(i: int, value: float) -> np.ndarray:
    k = search_vectors(1)[0]
    k[i] = value
    return k


@pytest.mark.parametrize(
    ("k", "message"),
    [
        (np.zeros(21), r"k:.* \(22,\), k1 to k22.* \(21,\)"),
        (np.zeros((1, 22)), r"k:.* \(22,\).*got \(1, 22\)"),
        (["small"] * 22, r"k:.* 22 numbers"),
        (0.5, r"k:.* \(22,\).*got \(\)"),
        (replaced(0, 0.16), r"k1:.* \[0, 0.15\].* 0.16"),
        (replaced(3, 0.09), r"k4:.* \[0.1, 0.2\].* 0.09"),
        (replaced(21, 71.0), r"k22:.* \[30, 70\].* 71"),
        (replaced(7, np.nan), r"k8:.* \[0.1, 0.4\].* nan"),
        (replaced(11, -np.inf), r"k12:.* \[0, 10\].* -inf"),
    ],
)
def test_checked_refuses(k: object, message: str) -> None:
    with pytest.raises(FuzzyError, match=message):
        space(dtype="float32").checked(k)


# Searched rules -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_the_whole_part_of_each_further_number_is_the_term_of_a_rule() -> None:
    made = space("fuzzy.rules=searched")
    assert made.lower.shape == made.upper.shape == (47,)
    np.testing.assert_array_equal(made.lower[22:], 0)
    np.testing.assert_array_equal(made.upper[22:], 5)
    np.testing.assert_array_equal(made.lower[:22], reference.PAPER_LOWER)
    cells = np.linspace(0, 5, 25)
    controller = made.controller(jnp.asarray([*search_vectors(1)[0], *cells]))
    expected = np.minimum(np.floor(cells), 4).reshape(5, 5)
    np.testing.assert_array_equal(controller.rules, expected)
    again = made.controller(made.checked(made.vector(controller)))
    assert again.rules == controller.rules
    inputs, outputs = all_terms(space(), np.resize(search_vectors(1), (COUNT, 22)))
    np.testing.assert_array_equal(controller.input_terms, inputs[0])
    np.testing.assert_array_equal(controller.output_terms, outputs[0])
    with pytest.raises(FuzzyError, match=r"\(47,\), k1 to k22 and 25 of the rules.* \(22,\)"):
        made.checked(search_vectors(1)[0])
    with pytest.raises(FuzzyError, match=r"rule 3:.* \[0, 5\].* 6"):
        made.checked([*search_vectors(1)[0], 0, 0, 6, *[0] * 22])


def test_heights_are_those_of_the_table_bit_for_bit() -> None:
    made = space("fuzzy.rules=searched", dtype="float32")
    rng = np.random.default_rng(1)
    cells = rng.uniform(0, 5, (3, 25))  # each table compiles its own program
    cells[0] = 5 * rng.integers(0, 2, 25)  # the ends of the box
    vectors = jnp.asarray(np.concatenate([search_vectors(3), cells], axis=1), jnp.float32)
    error, rate = (jnp.asarray(rng.uniform(0, 1, 50), jnp.float32) for _ in range(2))
    same = jnp.zeros(50, jnp.float32)

    def gain(vector: jax.Array) -> jax.Array:
        schedule = made.schedule(vector)
        assert isinstance(schedule, SearchedRulesGain)
        return schedule.prepare()(ScheduleInputs(error, rate, time=same, last=same)).gain

    gains = jax.jit(jax.vmap(gain))(vectors)
    memberships = [tuple(rng.uniform(-0.2, 1, (5, 50)).clip(0, 1)) for _ in range(2)]
    by_table = jax.jit(lambda given, rules: firing_heights(*given, rules, 5), static_argnums=1)
    by_targets = jax.jit(lambda given, targets: searched_heights(*given, targets))
    for i, vector in enumerate(vectors):
        schedule = made.schedule(vector)
        assert type(schedule) is FuzzyGain, "outside jit the rules are a table"
        rules = schedule.controller.rules
        targets = tuple(tuple(map(np.float32, row)) for row in rules)
        found = by_targets(memberships, targets)
        for a, b in zip(found, by_table(memberships, rules), strict=True):
            np.testing.assert_array_equal(a, b)

        @jax.jit
        def by_controller(controller: FuzzyController) -> jax.Array:
            fires = jnp.max(jnp.stack(controller.heights(error, rate)), axis=0) > 0
            return jnp.where(fires, controller(error, rate), 0)

        np.testing.assert_allclose(gains[i], by_controller(schedule.controller), rtol=1e-5)
