"""Write the results of a benchmark to a page, between the marks with its name."""

from pathlib import Path

ROOT = Path(__file__).parent.parent


def write_block(name: str, text: str, page: str = "README.md") -> None:
    """Replace the text between `<!-- NAME: begin -->` and `<!-- NAME: end -->` in a page.

    Raises:
        ValueError: The page does not have these marks exactly once.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    path = ROOT / page
    held = path.read_text(encoding="utf-8")
    if (held.count(begin), held.count(end)) != (1, 1):
        raise ValueError(f"{page}: must have {begin} and {end} once each")
    before, rest = held.split(begin)
    _, after = rest.split(end)
    path.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
