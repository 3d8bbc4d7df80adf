"""Puts what a benchmark measured into a page, between the marks of its name."""

from pathlib import Path

ROOT = Path(__file__).parent.parent


def write_block(name: str, text: str, page: str = "README.md") -> None:
    """Replace what stands between `<!-- NAME: begin -->` and `<!-- NAME: end -->` in a page."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    path = ROOT / page
    before, rest = path.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(end)
    path.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
