"""Refusals of types of one's own: unions told apart by a tag, unions of tables, several at once."""

from collections.abc import Iterator
from typing import Annotated, Literal

import pytest

from posegsa.errors import ConfigError
from posegsa.settings.choice import Choice
from posegsa.settings.fields import Ascending, Count, NonNegative, Section
from posegsa.settings.violations import Violation

pytestmark = pytest.mark.quick


class Swarm(Section):
    optimiser: Literal["swarm"] = "swarm"
    """The tag."""
    particles: Count = 10
    """A count."""
    inertia: NonNegative = 0.7
    """A number."""


class Descent(Section):
    optimiser: Literal["descent"] = "descent"
    """The tag."""
    starts: Count = 8
    """A count."""


class Then(Section):
    optimiser: Literal["swarm+descent"] = "swarm+descent"
    """The tag."""
    first: Swarm = Swarm()
    """A table of the same keys, further down."""
    start: Annotated[tuple[NonNegative, NonNegative], Ascending] | Literal["none"] = "none"
    """A pair."""

    def _conflicts(self) -> Iterator[Violation]:
        if self.first.particles > 5:
            yield Violation("first.particles", "allowed: at most 5", self.first.particles)
            yield Violation("first.particles", "allowed: fewer than first.inertia")


class Root(Section):
    search: Annotated[
        Swarm | Descent | Then,
        Choice("optimiser", {"swarm": Swarm, "descent": Descent, "swarm+descent": Then}),
    ] = Swarm()
    """A union told apart by its tag."""
    particles: Literal[1, 2] = 1
    """A key that a member of the union has too."""


def refusal(search: object, **others: object) -> str:
    with pytest.raises(ConfigError) as caught:
        Root(search=search, **others)
    return " ".join(str(caught.value).split())


@pytest.mark.parametrize(
    ("search", "said"),
    [
        ({"optimiser": "swarm", "particles": 0}, "search.particles = 0 should be greater than or"),
        ({"optimiser": "descent", "starts": "x"}, 'search.starts = "x" should be a valid integer'),
        (
            {"optimiser": "Swarn"},
            "search.optimiser = \"Swarn\" should be 'swarm', 'descent', 'swarm+descent'; did you "
            "mean 'swarm'?",
        ),
        ({"optimiser": 3}, "search.optimiser = 3 should be 'swarm', 'descent', 'swarm+descent'"),
        ({"starts": 3}, "search.starts unknown key; known here: optimiser, particles"),
        (3, "search = 3 should be a table with the keys optimiser, particles, inertia, starts"),
        ({"optimiser": "swarm", "inertai": 1}, "search.inertai unknown key; did you mean search.i"),
        ({"optimiser": "descent", "inertia": 1}, "search.inertia unknown key; known here: optimi"),
        (
            {"optimiser": "swarm+descent", "first": {"inertia": -1}},
            "search.first.inertia = -1 should be greater than or equal to 0",
        ),
        (
            {"optimiser": "swarm+descent", "first": {"inertai": 1}},
            "search.first.inertai unknown key; did you mean search.first.inertia?",
        ),
        (
            {"optimiser": "swarm+descent", "start": (2, 1)},
            "search.start = [2, 1] allowed: a first value that is not above the second, or should "
            "be 'none'",
        ),
    ],
)
def test_members_of_a_union_are_named_as_a_file_has_them(search: object, said: str) -> None:
    text = refusal(search)
    assert said in text
    for tag in ("swarm.", "descent.", "pydantic", "Input"):
        assert tag not in text.replace("search.", "")


def test_keys_of_the_member_that_is_meant_are_known() -> None:
    text = refusal({"optimiser": "descent", "inertia": 1})
    assert text.endswith("known here: optimiser, starts")


def test_each_conflict_of_a_section_is_told_with_its_key() -> None:
    text = refusal({"optimiser": "swarm+descent"}, particles=3)
    assert "search.first.particles = 10 allowed: at most 5" in text
    assert "search.first.particles allowed: fewer" in text
    assert "particles = 3 should be 1 or 2" in text
