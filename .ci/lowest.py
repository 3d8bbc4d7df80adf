"""Prints what pyproject.toml requires, each at the lowest version that it states, for pip.

    python .ci/lowest.py [EXTRA...]

Whatever is stated as NAME>=VERSION becomes NAME==VERSION; what it requires in turn pip chooses.
"""

import re
import sys
import tomllib
from pathlib import Path

_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(?P<extras>\[[\w,-]+\])?(>=(?P<version>[\d.]+).*)?")
PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))[
    "project"
]


def lowest(requirements: list[str]) -> list[str]:
    """The requirements at their lowest versions; those of the project's own extras in their place.

    Raises:
        ValueError: One states no lowest version.
    """
    found = []
    for text in requirements:
        stated = _REQUIREMENT.fullmatch(text)
        if stated and stated["name"] == PROJECT["name"]:
            for extra in stated["extras"].strip("[]").split(","):
                found += lowest(PROJECT["optional-dependencies"][extra])
        elif stated and stated["version"]:
            found.append(f"{stated['name']}{stated['extras'] or ''}=={stated['version']}")
        else:
            raise ValueError(f"{text}: states no lowest version; allowed: NAME>=VERSION")
    return found


if __name__ == "__main__":
    given = [*PROJECT["dependencies"], *(f"{PROJECT['name']}[{extra}]" for extra in sys.argv[1:])]
    print("\n".join(lowest(given)))
