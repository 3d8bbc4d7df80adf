"""What the command line shows of long work, on standard error.

On a terminal the last line is that of the present step: how much of it is done, since when, and how
long the rest will take. Elsewhere, as in a file or on a terminal that can't go back in a line
(TERM=dumb), a line is written now and then. Neither has colours (NO_COLOR).
"""

import io
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self, TextIO

from posegsa import steps
from posegsa.steps import Step

if TYPE_CHECKING:
    from posegsa.comparing import Status
    from posegsa.search.run import Progress
    from posegsa.sweeping import SweepStatus

BETWEEN_LINES = 10.0
"""Time between two lines of the same part, where nothing is drawn [s]."""
BETWEEN_DRAWN = 0.1
"""Time between two states of a line that is drawn [s]."""
BAR = 20
"""Characters of the bar."""
FIRST_PIECES = 5.0
"""Time after which the pieces of a first iteration tell how long a search will take [s]."""
LONG = 10.0
"""Time that a search must take for it to be said beforehand [s]."""


class Display:
    """A context that shows the steps of the work within it.

    Nothing is shown before the first step begins: of work that is refused nothing is seen.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Show steps on a stream, by default standard error, unless it is to be quiet."""
        given = sys.stderr if stream is None else stream
        self.stream = io.StringIO() if given is None else given  # standard error may be closed
        self.quiet, self.clock = quiet, clock
        self.drawn = self.stream.isatty() and os.environ.get("TERM") != "dumb"
        self.present: Step | None = None
        """The step that is shown."""
        self.began = False
        """Whether any step has begun."""
        self._begun = self._written = 0.0
        self._began_with = 0.0
        self._width = 0
        self._context = ExitStack()

    def __enter__(self) -> Self:
        """Listen to the steps."""
        self._context.enter_context(steps.listening(self.show))
        _SHOWN.append(self)
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """End the present step."""
        self._context.close()
        _SHOWN.remove(self)
        self._end("stopped" if error is not None else "done")

    def show(self, step: Step) -> None:
        """Show where the work stands."""
        now, before = self.clock(), self.present
        if before is None or step.name != before.name:
            self._end("done")
            self._begun, self._began_with = now, step.done
            before = None
        self.present, self.began = step, True
        another = before is None or step.about != before.about
        whole = step.done >= step.parts
        least = BETWEEN_DRAWN if self.drawn else BETWEEN_LINES
        if another or now - self._written >= least or (self.drawn and whole):
            self._write(self._words(now))
            self._written = now

    def say(self, text: str) -> None:
        """Write a line above what is drawn."""
        self._clear()
        print(text, file=self.stream, flush=True)

    def _end(self, ended: str) -> None:
        """Leave a line of the step that was shown, with the time that it took."""
        if self.present is None or self.quiet:
            return
        name, done, parts, _, best_cost = self.present
        self.present = None
        if ended == "stopped" and done == 0:  # of what was refused as it began nothing stays
            self._clear()
            return
        took = f"{ended} after {span(self.clock() - self._begun)}"
        count = f" {int(done)}/{parts}" if best_cost is not None else ""
        known = best_cost is not None and math.isfinite(best_cost)
        best = f", best cost {best_cost:.4g}" if known else ""
        self.say(f"{name}{count}: {took}{best}")

    def _words(self, now: float) -> str:
        """The present step in words."""
        assert self.present is not None
        name, done, parts, about, best_cost = self.present
        if parts == 1 and done == 0:
            return f"{name}{f' {about}' if about else ''} ..."
        if best_cost is not None and math.isfinite(best_cost):
            about = f"best cost {best_cost:.4g}"
        left = self._left(now)
        tail = [about] * bool(about) + [f"{span(left)} left"] * (left is not None)
        if not self.drawn:
            return f"{name} {int(done)}/{parts}{''.join(f', {word}' for word in tail)}"
        filled = int(BAR * min(done / parts, 1))
        bar = "#" * filled + "." * (BAR - filled)
        return f"{name} [{bar}] {int(done)}/{parts}{''.join(f', {word}' for word in tail)}"

    def _left(self, now: float) -> float | None:
        """The time that the rest of the step will take [s], once that can be told."""
        assert self.present is not None
        done, elapsed = self.present.done - self._began_with, now - self._begun
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


_SHOWN: list[Display] = []


def say(text: str) -> None:
    """Write a line to standard error, above what is drawn there."""
    if _SHOWN:
        _SHOWN[-1].say(text)
    else:
        print(text, file=sys.stderr or io.StringIO(), flush=True)


class TuneDisplay(Display):
    """Shows a search, and says how long it will take after its first iteration."""

    def __init__(self, judging: str, *, quiet: bool = False) -> None:
        """Show a search; `judging` says what comes after it, in words."""
        super().__init__(quiet=quiet)
        self.judging = judging
        self._from: int | None = None
        self._said = False

    def __call__(self, progress: "Progress") -> None:
        """Show where the search stands."""
        iteration, iterations, best_cost, seconds = progress
        if self._from is None:
            self._from = iteration
        done = iteration - self._from
        if (done >= 1 or (done > 0 and seconds >= FIRST_PIECES)) and not self._said:
            self._said = True
            whole = seconds / done * (iterations - self._from)
            if whole >= LONG and not self.quiet:
                self.say(f"about {span(whole)} to search; {self.judging}")
        self.show(Step("searching", iteration, iterations, best_cost=best_cost))


class CompareDisplay(Display):
    """Shows all searches of a comparison."""

    def __init__(self, optimisers: Sequence[str], *, quiet: bool = False) -> None:
        """Show the searches of these."""
        super().__init__(quiet=quiet)
        self.optimisers = optimisers

    def __call__(self, status: "Status") -> None:
        """Show where the comparison stands; what a folder held already counts as done."""
        before = self.optimisers.index(status.optimiser) * status.repeats + status.repeat
        self.show(
            Step(
                name="comparing",
                done=before + status.share,
                parts=len(self.optimisers) * status.repeats,
                about=f"{status.optimiser} {status.repeat + 1}/{status.repeats}",
            )
        )


class SweepDisplay(Display):
    """Shows all runs of a sweep."""

    def __call__(self, status: "SweepStatus") -> None:
        """Show where the sweep stands; what a folder held already counts as done."""
        self.show(
            Step(
                name="sweeping",
                done=status.done + status.running,
                parts=status.runs,
                best_cost=status.best_cost if math.isfinite(status.best_cost) else None,
            )
        )


def span(seconds: float | None) -> str:
    """A time for a person: "8 s", "4 min", "2.5 h"."""
    if seconds is None or seconds < 0.95:
        return "under 1 s"
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 99.5 * 60 else f"{seconds / 3600:.1f} h"
