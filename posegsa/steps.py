"""Progress of long work: the steps of a job, told to whoever listens.

A job says here which step it begins and how far it is. Nothing happens unless somebody listens:

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
    """In one word, such as "searching" or "judging"."""
    done: float = 0.0
    """Parts that are done; of a search, iterations."""
    parts: int = 1
    """Parts in all."""
    about: str = ""
    """What the present part is, in words."""
    best_cost: float | None = None
    """Of a search, the best so far, infinite before any; None of other steps."""


Listener = Callable[[Step], object]
"""What is called with each step as it begins and goes on; what it raises stops the work."""

_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)
_PRESENT: ContextVar[Step | None] = ContextVar("present", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """A context whose steps, in this thread, are told to a function.

    It listens instead of any other; with None, whoever listens already goes on.
    """
    token = _LISTENER.set(listener or _LISTENER.get())
    before = _PRESENT.set(_PRESENT.get())
    try:
        yield
    finally:
        _LISTENER.reset(token)
        _PRESENT.reset(before)


def tell(step: Step) -> None:
    """Tell how far a step is; it is the present one from now on."""
    _PRESENT.set(step)
    share(0.0)


def begin(name: str, done: int = 0, parts: int = 1, about: str = "") -> None:
    """Tell that a step begins, or the next part of it."""
    tell(Step(name, done, parts, about))


def share(part: float) -> None:
    """Tell how much of the present part is done, in [0, 1]."""
    present, listener = _PRESENT.get(), _LISTENER.get()
    if present is not None and listener is not None:
        listener(present._replace(done=present.done + part))


def each(
    name: str, items: Sequence[Item], about: Callable[[Item], str] = lambda _: ""
) -> Iterator[Item]:
    """Items one by one, each a part of a step."""
    for done, item in enumerate(items):
        begin(name, done, len(items), about(item))
        yield item
