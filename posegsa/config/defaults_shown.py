"""A configuration as text that also shows the keys of [filter] that stand at their defaults."""

import re
from itertools import takewhile

import tomli_w

from posegsa.config.experiment import Experiment
from posegsa.settings.fields import Section

FILTER = "[filter]"
HEAD = "# The other keys of [filter], at their defaults:"


def with_defaults_shown(text: str, experiment: Experiment) -> str:
    """A TOML file with the keys of [filter] that it leaves out, as comments in that section.

    Without the leading `# ` each of these lines states its default. Tables within [filter] are left
    out.

    Args:
        text: The file.
        experiment: What it holds.
    """
    lines = text.rstrip().splitlines()
    if FILTER not in lines:
        lines += ["", FILTER]
    at = lines.index(FILTER) + 1
    inside = list(takewhile(lambda line: not line.startswith("["), lines[at:]))
    while inside and (not inside[-1] or inside[-1].startswith("#")):  # these belong to what follows
        inside.pop()
    stated = {line.partition("=")[0].strip() for line in inside}
    left_out = [
        f"# {tomli_w.dumps({key: value}).strip()}  # {_about(experiment.filter, key)}"
        for key, value in experiment.filter.model_dump(mode="json").items()
        if key not in stated and not isinstance(value, dict | list | None)
    ]
    end = at + len(inside)
    shown = [HEAD, *left_out] if left_out else []
    return "\n".join([*lines[:end], *shown, *lines[end:], ""])


def _about(section: Section, key: str) -> str:
    """The meaning of a key with its unit: the first sentence of its description."""
    described = type(section).model_fields[key].description or ""
    return re.split(r"(?<=\.)\s", " ".join(described.split()))[0]
