"""Checks that a message states the field, the value and what is allowed, in any wording."""

import re


def assert_states(text: str, *facts: str) -> None:
    """Check that a message has each of these names, numbers and words as a separate word.

    A bound of 1 is then not found in the value -1 or 0.1. Line breaks count as spaces.
    """
    said = " ".join(text.split())
    for fact in facts:
        assert re.search(rf"(?<![\w.-]){re.escape(fact)}(?!\.?\w)", said), (fact, said)
