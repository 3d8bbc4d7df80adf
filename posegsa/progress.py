"""The progress of long jobs, shown on standard error.

On a terminal the last line shows the current step: how much is done, and the remaining time.
In a file, or on a terminal that can't redraw a line (TERM=dumb), a new line is written from time to
time. There are no colours (NO_COLOR).

The command shows it, and so do jobs in a Jupyter notebook, unless they are given a listener.
"""

import io
import math
import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import Self, TextIO

from posegsa import steps
from posegsa.steps import Step

BETWEEN_LINES = 10.0
"""Minimum time between two written lines of the same part [s]."""
BETWEEN_DRAWN = 0.1
"""Minimum time between two updates of a redrawn line [s]."""
BAR = 20
"""Length of the progress bar in characters."""
LONG = 10.0
"""If a search takes at least this long [s], a line says so after its first iteration."""


class Display:
    """A context that shows the steps of the job within it.

    Nothing is shown before the first step starts, so a refused job shows nothing.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        after_search: str = "",
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Show steps.

        Args:
            quiet: Show nothing.
            after_search: Describes the work after the search. If given, a line after the first
                iteration says how long the search will take.
            stream: Where to write; by default standard error.
            clock: Returns the time [s].
        """
        given = sys.stderr if stream is None else stream
        self.stream = io.StringIO() if given is None else given  # standard error may be closed
        self.quiet, self.after_search, self.clock = quiet, after_search, clock
        redraws = self.stream.isatty() and os.environ.get("TERM") != "dumb"
        self.drawn = redraws or (stream is None and in_notebook())
        self.present: Step | None = None
        """The current step."""
        self.started_any = False
        """Whether any step has started."""
        self._started = self._written = 0.0
        self._done_at_start = 0.0
        self._width = 0
        self._context = ExitStack()

    def __enter__(self) -> Self:
        """Start listening to the steps."""
        self._context.enter_context(steps.listening(self.show))
        _SHOWN.append(self)
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """End the current step."""
        self._context.close()
        _SHOWN.remove(self)
        self._end("stopped" if error is not None else "done")

    def show(self, step: Step) -> None:
        """Show a step's progress."""
        now, before = self.clock(), self.present
        if before is None or step.name != before.name:
            self._end("done")
            self._started, self._done_at_start = now, step.done
            before = None
        self.present, self.started_any = step, True
        self._say_whole(now)
        another = before is None or step.about != before.about
        whole = step.done >= step.parts
        least = BETWEEN_DRAWN if self.drawn else BETWEEN_LINES
        if another or now - self._written >= least or (self.drawn and whole):
            self._write(self._words(now))
            self._written = now

    def say(self, text: str) -> None:
        """Write a line above the redrawn one."""
        self._clear()
        print(text, file=self.stream, flush=True)

    def _say_whole(self, now: float) -> None:
        """Once, after the first iteration of a search, say how long the whole search takes."""
        assert self.present is not None
        done = self.present.done - self._done_at_start
        if not self.after_search or self.present.best_cost is None or done < 1:
            return
        whole = (now - self._started) / done * (self.present.parts - self._done_at_start)
        if whole >= LONG and not self.quiet:
            self.say(f"the search takes about {span(whole)}; {self.after_search}")
        self.after_search = ""

    def _end(self, ended: str) -> None:
        """End the current step with a line that says how long it took."""
        if self.present is None or self.quiet:
            return
        name, done, parts, about, best_cost = self.present
        if about:  # the cost is that of the last part alone
            best_cost = None
        self.present = None
        if ended == "stopped" and done == 0:  # refused at its start: show nothing
            self._clear()
            return
        took = f"{ended} after {span(self.clock() - self._started)}"
        count = f" {int(done)}/{parts}" if best_cost is not None else ""
        known = best_cost is not None and math.isfinite(best_cost)
        best = f", best cost {best_cost:.4g}" if known else ""
        self.say(f"{name}{count}: {took}{best}")

    def _words(self, now: float) -> str:
        """The current step in words."""
        assert self.present is not None
        name, done, parts, about, best_cost = self.present
        if parts == 1 and done == 0:
            return f"{name}{f' {about}' if about else ''} ..."
        tail, left = [about] * bool(about), self._left(now)
        if best_cost is not None and math.isfinite(best_cost):
            tail.append(f"best cost {best_cost:.4g}")
        if left is not None:
            tail.append(f"{span(left)} left")
        bar = ""
        if self.drawn:
            filled = int(BAR * min(done / parts, 1))
            bar = f"[{'#' * filled}{'.' * (BAR - filled)}] "
        return f"{name} {bar}{', '.join([f'{int(done)}/{parts}', *tail])}"

    def _left(self, now: float) -> float | None:
        """The remaining time of the step [s]; None while it can't be estimated."""
        assert self.present is not None
        done, elapsed = self.present.done - self._done_at_start, now - self._started
        if done <= 0 or elapsed < 1:
            return None
        return elapsed / done * (self.present.parts - self.present.done)

    def _write(self, text: str) -> None:
        if self.quiet:
            return
        if not self.drawn:
            self.say(text)
            return
        columns = shutil.get_terminal_size().columns - 1
        line = text[:columns]
        self.stream.write("\r" + line.ljust(self._width))
        self.stream.flush()
        self._width = len(line)

    def _clear(self) -> None:
        if self._width:
            self.stream.write("\r" + " " * self._width + "\r")
            self._width = 0


def shown(listener: steps.Listener | None) -> AbstractContextManager[object]:
    """A context that reports the steps of a job: to a listener, or in a notebook to its reader."""
    if listener is None and in_notebook() and not steps.heard():
        return Display()
    return steps.listening(listener)


def in_notebook() -> bool:
    """Whether this process is the kernel of a Jupyter notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell"


_SHOWN: list[Display] = []


def say(text: str) -> None:
    """Write a line to standard error, above the redrawn one."""
    if _SHOWN:
        _SHOWN[-1].say(text)
    else:
        print(text, file=sys.stderr or io.StringIO(), flush=True)


def span(seconds: float | None) -> str:
    """A duration in words: "8 s", "4 min", "2.5 h"."""
    if seconds is None or seconds < 0.95:
        return "under 1 s"
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 99.5 * 60 else f"{seconds / 3600:.1f} h"
