"""Errors in sections: a union whose member a tag selects, a union of tables, several errors."""

from collections.abc import Iterator
from typing import Annotated, Literal

import pytest
from helpers.messages import assert_states

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
    """A union discriminated by its tag."""
    particles: Literal[1, 2] = 1
    """A key that a member of the union has too."""


def refusal(search: object, **others: object) -> str:
    with pytest.raises(ConfigError) as caught:
        Root(search=search, **others)
    return " ".join(str(caught.value).split())


@pytest.mark.parametrize(
    ("search", "facts"),
    [
        ({"optimiser": "swarm", "particles": 0}, ["search.particles = 0", "1"]),
        ({"optimiser": "descent", "starts": "x"}, ['search.starts = "x"', "integer"]),
        (
            {"optimiser": "Swarn"},
            ['search.optimiser = "Swarn"', "descent", "swarm+descent", "did you mean 'swarm'"],
        ),
        ({"optimiser": 3}, ["search.optimiser = 3", "swarm", "descent", "swarm+descent"]),
        ({"starts": 3}, ["search.starts", "optimiser", "particles"]),
        (3, ["search = 3", "table", "optimiser", "particles", "inertia", "starts"]),
        (
            {"optimiser": "swarm", "inertai": 1},
            ["search.inertai", "did you mean search.inertia"],
        ),
        (
            {"optimiser": "swarm+descent", "first": {"inertia": -1}},
            ["search.first.inertia = -1", "0"],
        ),
        (
            {"optimiser": "swarm+descent", "first": {"inertai": 1}},
            ["search.first.inertai", "did you mean search.first.inertia"],
        ),
        ({"optimiser": "swarm+descent", "start": (2, 1)}, ["search.start = [2, 1]", "none"]),
    ],
)
def test_members_of_a_union_are_named_as_a_file_has_them(search: object, facts: list[str]) -> None:
    text = refusal(search)
    assert_states(text, *facts)
    for tag in ("swarm.", "descent.", "pydantic", "Input"):
        assert tag not in text.replace("search.", "")


def test_keys_of_the_member_that_is_meant_are_known() -> None:
    text = refusal({"optimiser": "descent", "inertia": 1})
    assert_states(text, "search.inertia", "optimiser", "starts")
    assert "particles" not in text


def test_each_conflict_of_a_section_is_reported_with_its_key() -> None:
    text = refusal({"optimiser": "swarm+descent"}, particles=3)
    assert_states(text, "search.first.particles = 10", "at most 5")
    assert_states(text, "search.first.particles allowed: fewer")
    assert_states(text, "particles = 3", "1", "2")
