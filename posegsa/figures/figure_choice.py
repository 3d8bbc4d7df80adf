"""The user's choice of figures."""

from collections.abc import Iterable

from posegsa.arguments import refuse, several
from posegsa.words import meant


def chosen_figures(figures: Iterable[str] | None, known: Iterable[str]) -> list[str]:
    """Checked names of figures from a user; None means all known ones.

    Raises:
        ArgumentError: A name is not known.
    """
    names = list(known)
    if figures is None:
        return names
    chosen = several("figures", figures, str, "names of figures")
    for name in chosen:
        if name not in names:
            refuse(f"figures: {name!r}", f"{', '.join(names)}{meant(name, names)}")
    return list(dict.fromkeys(chosen))
