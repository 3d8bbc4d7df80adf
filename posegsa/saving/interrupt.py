"""Signals: the first asks a search to save its state and stop, the second stops it at once.

They are Ctrl-C, SIGTERM and SIGUSR1, which clusters such as Slurm send before a job's time limit.
Python handles signals in the main thread only. Handlers of the user's program are left in place,
and so is an ignored SIGINT, as under `nohup`.
"""

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from posegsa.errors import SearchInterrupted

TERMINATING = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGUSR1") if hasattr(signal, name)
)
"""Signals that end the process without a message by default; Windows has no SIGUSR1."""
SIGNALS = (signal.SIGINT, *TERMINATING)
PATIENCE = 5.0
"""Time after a first signal until the process is ended if compiled code is still running [s].
Chunks of a search are shorter, unless a single iteration takes longer."""


class StopRequest:
    """Whether a signal has asked the search to stop."""

    signal_number: int | None = None
    """The first signal received; None if there was none."""


@contextmanager
def deferred_signals() -> Iterator[StopRequest]:
    """Record the first signal for the search to check; the second raises SearchInterrupted."""
    request = StopRequest()

    def note(number: int, frame: FrameType | None) -> None:
        if request.signal_number is not None:
            raise SearchInterrupted(_STOPPED, number)
        request.signal_number = number

    with _handled(note):
        yield request


@contextmanager
def resumable(how: Callable[[], str]) -> Iterator[None]:
    """Add to an interruption within the context a message that says how to resume.

    Args:
        how: Returns the message; it must not wait for compiled code.

    Raises:
        SearchInterrupted: Instead of a KeyboardInterrupt.
    """
    _HOW.append(how)
    try:
        yield
    except SearchInterrupted as stopped:
        if str(stopped) != _STOPPED:
            raise
        raise SearchInterrupted(how(), stopped.signal_number) from None
    except KeyboardInterrupt:
        raise SearchInterrupted(how(), signal.SIGINT) from None
    finally:
        _HOW.remove(how)


@contextmanager
def immediate_signals(
    on_first: Callable[[], object], say: Callable[[str], object] = lambda _: None
) -> Iterator[None]:
    """Make SIGTERM and SIGUSR1 raise like Ctrl-C, and end the process soon in any case.

    Python handles signals only between its own instructions, not while a compiled loop runs, so a
    thread reads them from the system. It calls `on_first` at the first signal, and ends the process
    PATIENCE later or at the second signal. For programs that own their process, such as the command
    line.

    Args:
        on_first: Called at the first signal, by the thread.
        say: Called with the message of `resumable` before the process ends after PATIENCE.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)

    def watch() -> None:
        first: int | None = None
        while number := _next_of(reader):
            if number in SIGNALS:
                if first is not None:
                    os._exit(128 + number)
                first = number
                on_first()
                reader.settimeout(PATIENCE)
            elif number == _TIMEOUT and first is not None:
                say(_HOW[-1]() if _HOW else _STOPPED)
                os._exit(128 + first)

    def terminated(number: int, frame: FrameType | None) -> NoReturn:
        raise SearchInterrupted(_STOPPED, number)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    previous = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    _OWN.add(terminated)
    try:
        with _handled(terminated, TERMINATING):
            yield
    finally:
        _OWN.discard(terminated)
        signal.set_wakeup_fd(previous)
        writer.close()
        thread.join()
        reader.close()


_STOPPED = "stopped"
_TIMEOUT = -1
_HOW: list[Callable[[], str]] = []
"""The messages of the enclosing `resumable` contexts, the innermost last."""


def _next_of(reader: socket.socket) -> int:
    """The next signal, _TIMEOUT if none comes in time, 0 when no more will come."""
    try:
        read = reader.recv(1)
    except TimeoutError:
        return _TIMEOUT
    return read[0] if read else 0


_OWN: set[object] = set()
"""Handlers of this module, which may replace each other."""


@contextmanager
def _handled(
    handler: Callable[[int, FrameType | None], object], numbers: tuple[int, ...] = SIGNALS
) -> Iterator[None]:
    """Handle those signals for which the program has no handler."""
    usual = {signal.SIG_DFL, signal.default_int_handler, *_OWN}
    previous = {}
    if threading.current_thread() is threading.main_thread():
        for number in numbers:
            if signal.getsignal(number) in usual:
                previous[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)
