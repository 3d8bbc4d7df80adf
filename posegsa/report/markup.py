"""Small pieces of HTML, in which every text is escaped unless it is HTML already."""

import base64
import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from posegsa.figures.captioned import ResultFigure

MINUS, DASH, INFINITE = "\u2212", "\u2013", "\u221e"


class Html(str):
    """Text that is HTML and stays as it is; every other `str` is escaped."""

    __slots__ = ()


def element(name: str, *content: str, **attributes: str) -> Html:
    """An element around its content.

    Args:
        name: Its tag.
        content: Texts, which are escaped, and `Html`.
        attributes: A trailing underscore is dropped and others become hyphens, so that Python's
            words and ARIA's names can be given; empty ones are left out.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for key, value in attributes.items()
        if value
    )
    return Html(f"<{name}{written}>{join(content)}</{name}>")


def join(content: Iterable[str], between: str = "") -> Html:
    """Texts, which are escaped, and `Html`, one after the other."""
    return Html(between.join(each if isinstance(each, Html) else escape(each) for each in content))


def section(title: str, *content: str, level: int = 2, class_: str = "") -> Html:
    """A section under its heading."""
    return element("section", element(f"h{level}", title), join(content, "\n"), class_=class_)


def paragraph(*content: str, class_: str = "") -> Html:
    """A paragraph."""
    return element("p", *content, class_=class_)


def table(
    caption: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    class_: str = "",
    own: str = "",
) -> Html:
    """A table that scrolls in a box of its own where it is too wide.

    The first cell of each row is its head; the row with the head `own` is marked as the reader's.
    """
    head = join(element("th", column, scope="col") for column in columns)
    body = join(
        (
            element(
                "tr",
                element("th", first, scope="row"),
                *(element("td", cell) for cell in cells),
                class_="own" if own and first == own else "",
            )
            for first, *cells in rows
        ),
        "\n",
    )
    whole = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", element("tr", head)),
        element("tbody", body),
        class_=class_,
    )
    return element("div", whole, class_="scroll", role="region", aria_label=caption, tabindex="0")


def details(title: str, content: Html) -> Html:
    """Content that is shown when its title is clicked."""
    return element("details", element("summary", title), content)


def figure(described: ResultFigure, png: bytes) -> Html:
    """A PNG picture inside the page, with its words."""
    data = base64.b64encode(png).decode("ascii")
    image = Html(f'<img src="data:image/png;base64,{data}" alt="{escape(described.alternative)}">')
    words = (element("strong", f"{described.title}."), f" {described.caption}")
    picture = element("div", image, class_="picture")
    return element("figure", picture, element("figcaption", *words), id=f"figure-{described.name}")


def number(value: float | np.floating, form: str = ".2f") -> str:
    """A number for a person: a true minus, an infinity sign, and a dash for what has no value."""
    value = float(value)
    if math.isnan(value):
        return DASH
    if math.isinf(value):
        return INFINITE if value > 0 else MINUS + INFINITE
    text = format(abs(value), form).lstrip("+")
    if float(text) == 0:
        return text
    return (MINUS if value < 0 else "+" if form.startswith("+") else "") + text


def cost(value: float | np.floating, form: str = ".2f") -> str:
    """A cost: two decimals, or four digits from 10 000."""
    large = math.isfinite(value) and abs(value) >= 1e4
    return number(value, form.replace(".2f", ".4g") if large else form)


def interval(low: float, high: float, form: str = "+.2f") -> str:
    """An interval of costs; a dash where there is none."""
    if math.isnan(low) and math.isnan(high):
        return DASH
    return f"{cost(low, form)} to {cost(high, form)}"
