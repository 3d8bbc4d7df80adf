"""The first signal asks to stop, the second stops; what was there before is there after."""

import signal
import subprocess
import sys
import threading

import pytest

from posegsa.errors import SearchInterrupted
from posegsa.saving.interrupt import SIGNALS, deferred_signals, immediate_signals


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_is_noted_and_the_second_raises(number):
    before = [signal.getsignal(n) for n in SIGNALS]
    with deferred_signals() as asked:
        assert asked.signal_number is None
        signal.raise_signal(number)
        assert asked.signal_number == number
        with pytest.raises(SearchInterrupted) as stopped:
            signal.raise_signal(signal.SIGINT)
    assert isinstance(stopped.value, KeyboardInterrupt)
    assert stopped.value.signal_number == signal.SIGINT
    assert [signal.getsignal(n) for n in SIGNALS] == before


def test_a_programs_own_handler_stays():
    got = []
    previous = signal.signal(signal.SIGTERM, lambda *_: got.append("mine"))
    try:
        with deferred_signals() as asked, immediate_signals(lambda: None):
            signal.raise_signal(signal.SIGTERM)
        assert got == ["mine"]
        assert asked.signal_number is None
    finally:
        signal.signal(signal.SIGTERM, previous)


def test_other_threads_are_left_alone():
    def inside() -> None:
        with deferred_signals() as asked, immediate_signals(lambda: None):
            found.append(asked.signal_number)

    found: list[int | None] = []
    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert found == [None]


def test_sigterm_raises_where_nothing_is_deferred():
    before, told = signal.getsignal(signal.SIGTERM), threading.Event()
    with immediate_signals(told.set), pytest.raises(SearchInterrupted) as stopped:
        signal.raise_signal(signal.SIGTERM)
    assert stopped.value.signal_number == signal.SIGTERM
    assert told.is_set(), "by the thread, which the context waits for"
    assert signal.getsignal(signal.SIGTERM) is before


BUSY = """
import hashlib, os, signal, threading
from posegsa.saving.interrupt import immediate_signals, deferred_signals

def say():
    print("told", flush=True)
    os.kill(os.getpid(), signal.SIGINT)  # a second time, now that the first has been seen

with immediate_signals(say), deferred_signals():
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    while True:  # in compiled code for minutes, as a chunk of a search may be
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
"""


def test_the_second_stops_at_once_in_compiled_code():
    done = subprocess.run(
        [sys.executable, "-c", BUSY], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 128 + signal.SIGINT, done.stderr
    assert done.stdout == "told\n"
