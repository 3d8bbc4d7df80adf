"""Which of the figures that there are shall be drawn."""

from collections.abc import Iterable

from posegsa.arguments import refuse, several


def chosen_figures(figures: Iterable[str] | None, known: Iterable[str]) -> list[str]:
    """Names of figures from a user, checked; None is all that are known.

    Raises:
        ArgumentError: A name is none of them.
    """
    names = list(known)
    if figures is None:
        return names
    chosen = several("figures", figures, str, "names of figures")
    for name in chosen:
        if name not in names:
            refuse(f"figures: {name!r}", ", ".join(names))
    return list(dict.fromkeys(chosen))
