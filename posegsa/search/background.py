"""Work in the background, in a thread of its own.

XLA compiles a program on one core. What does not depend on the present step can be compiled and run
on the others.
"""

import contextvars
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
    wide = jax.config.read("jax_enable_x64")  # JAX keeps it for each thread

    def run() -> T:
        with jax.enable_x64(wide), steps.listening(lambda _: None):
            return work()

    # A process that ends waits for the thread: XLA crashes if it ends while a program is compiled.
    thread = ThreadPoolExecutor(1)
    future = thread.submit(contextvars.copy_context().run, run)
    thread.shutdown(wait=False)  # once the work is done
    return future.result
