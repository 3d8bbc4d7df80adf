"""The steps of long work, told to whoever shows them.

What takes long says here what it does next (`begin`), and how much of that is done (`share`).
Nothing happens unless somebody listens, as the command line does:

    with listening(lambda step: print(step.name, step.about)):
        posegsa.tune("quick")
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple, TypeVar

Item = TypeVar("Item")


class Step(NamedTuple):
    """What is being done, and how much of it is done."""

    name: str
    """In one word, such as "judging"."""
    done: float = 0.0
    """Parts that are done."""
    parts: int = 1
    """Parts in all."""
    about: str = ""
    """What the present part is, in words."""
    best_cost: float | None = None
    """Of a search."""


Listener = Callable[[Step], object]

_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)
_PRESENT: ContextVar[Step | None] = ContextVar("present", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Have a function told each step, and how far it is, while the context lasts; in this thread.

    What it raises stops the work.
    """
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def begin(name: str, done: int = 0, parts: int = 1, about: str = "") -> None:
    """Say that a step begins, or the next part of it."""
    _PRESENT.set(Step(name, done, parts, about))
    share(0.0)


def share(part: float) -> None:
    """Say how much of the present part is done, in [0, 1]."""
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
