"""The pages of reports."""

import re
from html.parser import HTMLParser

PICTURE = b"\x89PNG\r\n\x1a\n not more than that"
VOID = {"meta", "img", "br"}


def spaced(text: str) -> str:
    """A text as a browser shows it: consecutive spaces and line ends become one space."""
    return re.sub(r"[ \n]+", " ", text).strip(" ")


class Page(HTMLParser):
    """The elements, tables and texts of a page; elements must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict]] = []
        self.elements: list[tuple[str, dict]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append((tag, dict(attrs)))
        if tag == "table":
            self.rows: list[list[str]] = []
        elif tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        inside = [tag for tag, _ in self.open]
        if "style" in inside:
            return
        self.texts.append(data)
        if "caption" in inside:
            self.tables[data] = self.rows
        elif "td" in inside or "th" in inside:
            self.rows[-1][-1] += data

    @property
    def text(self) -> str:
        return spaced(" ".join(self.texts))

    def table(self, caption: str) -> list[list[str]]:
        (found,) = (rows for name, rows in self.tables.items() if name.startswith(caption))
        return [[spaced(cell) for cell in row] for row in found]
