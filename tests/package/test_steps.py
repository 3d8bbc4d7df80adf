"""Progress: the reported steps and their listeners."""

import pytest

from posegsa import steps
from posegsa.steps import Step

pytestmark = pytest.mark.quick


def test_each_part_of_a_step_is_reported_to_the_listener():
    reports: list[Step] = []
    with steps.listening(reports.append):
        assert list(steps.each("judging", ["a", "b"], str.upper)) == ["a", "b"]
        steps.share(0.25)
    assert reports == [
        Step("judging", 0, 2, "A"),
        Step("judging", 1, 2, "B"),
        Step("judging", 1.25, 2, "B"),
    ]


def test_nothing_before_or_after_is_reported():
    reports: list[Step] = []
    steps.begin("before")
    with steps.listening(reports.append):
        pass
    steps.begin("after")
    assert reports == []


def test_a_listener_within_another_hears_alone_and_none_leaves_the_other():
    outer: list[Step] = []
    inner: list[Step] = []
    with steps.listening(outer.append):
        with steps.listening(inner.append):
            steps.begin("a")
        with steps.listening(None):
            steps.begin("b")
    assert (inner, outer) == ([Step("a")], [Step("b")])


def test_what_a_listener_raises_stops_the_work():
    def stop(_: Step) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), steps.listening(stop):
        steps.begin("a")
