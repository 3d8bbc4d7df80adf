"""Progress of long jobs: each job reports its steps to a listener.

A job reports which step it begins and how much of it is done. Without a listener nothing happens:

    posegsa.tune("quick", progress=lambda step: print(step.name, step.done, step.parts))
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple, TypeVar

Item = TypeVar("Item")


class Step(NamedTuple):
    """A step of a job, and how much of it is done."""

    name: str
    """One word, such as "searching" or "judging"."""
    done: float = 0.0
    """Number of finished parts; for a search, iterations."""
    parts: int = 1
    """Total number of parts."""
    about: str = ""
    """Describes the current part."""
    best_cost: float | None = None
    """Best cost so far of the search, or of that of the current part; infinite before the first,
    None without a search."""


Listener = Callable[[Step], object]
"""A function called with each step as it begins and while it runs; if it raises, the job stops."""

_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)
_PRESENT: ContextVar[Step | None] = ContextVar("present", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """A context that reports the steps of this thread to a listener.

    The listener replaces the present one. With None, the present one stays.
    """
    token = _LISTENER.set(listener or _LISTENER.get())
    before = _PRESENT.set(_PRESENT.get())
    try:
        yield
    finally:
        _LISTENER.reset(token)
        _PRESENT.reset(before)


def heard() -> bool:
    """Whether anything listens to the steps of this thread."""
    return _LISTENER.get() is not None


def tell(step: Step) -> None:
    """Report a step; it is the current one from now on."""
    _PRESENT.set(step)
    share(0.0)


def begin(name: str, done: int = 0, parts: int = 1, about: str = "") -> None:
    """Report that a step, or its next part, begins."""
    tell(Step(name, done, parts, about))


def share(part: float, best_cost: float | None = None) -> None:
    """Report how much of the current part is done, in [0, 1], and the best cost if it searches."""
    present, listener = _PRESENT.get(), _LISTENER.get()
    if present is not None and listener is not None:
        best_cost = present.best_cost if best_cost is None else best_cost
        listener(present._replace(done=present.done + part, best_cost=best_cost))


def each(
    name: str, items: Sequence[Item], about: Callable[[Item], str] = lambda _: ""
) -> Iterator[Item]:
    """Iterate over items, and report each as a part of a step."""
    for done, item in enumerate(items):
        begin(name, done, len(items), about(item))
        yield item
