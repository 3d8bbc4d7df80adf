"""Work in the background, in a thread of its own.

XLA compiles a program on one core. What does not depend on the present step can be compiled and run
on the others.
"""

import contextvars
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

import jax

from posegsa import steps

T = TypeVar("T")


def in_background(work: Callable[[], T]) -> Callable[[], T]:
    """Begin work in another thread, with the caller's floating types.

    The steps of the work are not reported, since the caller's are.

    Returns:
        A function that waits for the work and returns its result, or raises its exception.
    """
    future: Future[T] = Future()
    wide = jax.config.read("jax_enable_x64")  # JAX keeps it for each thread

    def run() -> None:
        try:
            with jax.enable_x64(wide), steps.listening(lambda _: None):
                found = work()
        except BaseException as error:  # the waiting thread raises it
            future.set_exception(error)
        else:
            future.set_result(found)

    # A process that ends waits for it: XLA crashes if it ends while a program is compiled.
    threading.Thread(target=contextvars.copy_context().run, args=(run,)).start()
    return future.result
