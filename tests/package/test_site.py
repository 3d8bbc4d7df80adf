"""The pages of the site: every public name has its entry, every command that they show parses."""

import re
import shlex
from pathlib import Path

import pytest

import posegsa
from posegsa.cli.command import parser

pytestmark = pytest.mark.quick

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def test_every_public_name_is_in_the_reference_once():
    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    named = re.findall(r"^\.\. auto(?:class|function):: posegsa\.(\w+)$", pages, re.MULTILINE)
    public = {name for name in posegsa.__all__ if not name.startswith("_")}
    assert sorted(named) == sorted(public - {"config", "runtime"})  # modules


def test_the_page_has_all_fields_of_the_estimates():
    page = (DOCS / "python.md").read_text(encoding="utf-8").partition("## Estimates")[2]
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    assert re.findall(r"`(\w+)`", " ".join(rows)) == list(posegsa.Estimates._fields)


@pytest.mark.parametrize("page", sorted((DOCS / "tutorials").glob("*.md")), ids=lambda p: p.stem)
def test_commands_of_the_tutorials_parse(page: Path):
    text = re.sub(r"\\\n\s*", "", page.read_text(encoding="utf-8"))
    text = text.replace("$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT", "1/8")
    commands = re.findall(r"^(?:    )?posegsa (.*)$", text, re.MULTILINE)
    assert commands
    for command in commands:
        parser().parse_args(shlex.split(command.split(">")[0]))


def test_links_of_the_readme_lead_to_headings():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for path, anchor in re.findall(r"\]\((docs/[\w/.-]+)#([\w-]+)\)", text):
        headings = re.findall(r"^#+ (.*)$", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
        anchors = {re.sub(r"[^\w -]", "", each).lower().replace(" ", "-") for each in headings}
        assert anchor in anchors, f"{path}#{anchor}"
