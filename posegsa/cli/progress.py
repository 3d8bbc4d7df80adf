"""The command line's progress bars, contexts around what they show."""

from collections.abc import Sequence
from typing import Self

from posegsa.comparing import Status
from posegsa.search.run import Progress
from posegsa.sweeping import SweepStatus


class Bar:
    """A bar on standard error, whose line ends with what became of the work."""

    def __init__(self, total: int, counts: str, *, quiet: bool) -> None:
        """Show an empty bar for `total` units of work, with `counts` behind it in tqdm's words."""
        from tqdm import tqdm  # not at the top: --help need not wait for it

        self.bar = tqdm(
            total=total,
            desc="compiling",
            unit="it",
            disable=quiet,
            dynamic_ncols=True,
            bar_format=f"{{desc}} {{bar}} {counts}",
        )
        self.bar.refresh()
        self.searching = False

    def __enter__(self) -> Self:
        return self

    def show(self, done: float, best_cost: float) -> None:
        """Move the bar."""
        self.bar.set_postfix_str(f"best cost {best_cost:.4g}", refresh=False)
        self.bar.update(done - self.bar.n)

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """End the bar's line; of work that was refused before it began nothing stays."""
        self.bar.leave = self.searching or error is None
        self.bar.set_description_str("done" if error is None else "stopped")
        self.bar.close()


class TuneBar(Bar):
    """A search: iteration, best cost, rate, time left."""

    def __init__(self, iterations: int, *, quiet: bool) -> None:
        counts = "{n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"
        super().__init__(iterations, counts, quiet=quiet)

    def __call__(self, progress: Progress) -> None:
        """Show where the search stands."""
        if not self.searching:
            # Rate and time left are those of the search: the clock starts after compiling.
            self.searching = True
            self.bar.reset(total=progress.iterations)
            self.bar.initial = self.bar.n = progress.iteration
            self.bar.set_description_str("tuning")
            return
        self.show(progress.iteration, progress.best_cost)
        if progress.iteration == progress.iterations:
            self.bar.set_description_str("judging on unseen scenarios")


class CompareBar(Bar):
    """All searches of a comparison."""

    def __init__(self, optimisers: Sequence[str], repeats: int, *, quiet: bool) -> None:
        counts = "{percentage:3.0f}% [{elapsed}<{remaining}{postfix}]"
        super().__init__(len(optimisers) * repeats, counts, quiet=quiet)
        self.optimisers = optimisers

    def __call__(self, status: Status) -> None:
        """Show where the comparison stands; what a folder held already counts as done."""
        self.searching = True
        before = self.optimisers.index(status.optimiser) * status.repeats + status.repeat
        self.bar.set_description_str(f"{status.optimiser} {status.repeat + 1}/{status.repeats}")
        self.show(before + status.share, status.best_cost)


class SweepBar(Bar):
    """All runs of a sweep."""

    def __init__(self, *, quiet: bool) -> None:
        counts = "{n:.1f}/{total_fmt} runs [{elapsed}<{remaining}{postfix}]"
        super().__init__(1, counts, quiet=quiet)

    def __call__(self, status: SweepStatus) -> None:
        """Show where the sweep stands; time left is told from the runs that this call makes."""
        if not self.searching:
            self.searching = True
            self.bar.reset(total=status.runs)
            self.bar.initial = self.bar.n = status.done
        running = status.running > 0
        self.bar.set_description_str("searching" if running else "compiling")
        self.show(status.done + status.running, status.best_cost)
