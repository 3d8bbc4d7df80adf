"""docs/live/index.html: it is up to date, needs no network, recovers, and filters as the C does."""

import base64
import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers.compiled_c import COMPILERS, compile_c, needs_cc

LIVE = Path(__file__).parents[2] / "docs" / "live"
PAGE = (LIVE / "index.html").read_text(encoding="utf-8")
BROWSERS = list(filter(shutil.which, ("chromium", "chromium-browser", "google-chrome")))
FILTERS = ("recommended", "kalman", "observer", "disturbed")

needs_browser = pytest.mark.skipif(not BROWSERS, reason="there is no chromium")


@pytest.fixture(scope="module")
def build():
    """The script docs/live/build.py."""
    spec = importlib.util.spec_from_file_location("live_build", LIVE / "build.py")
    assert spec is not None
    assert spec.loader is not None
    spec.loader.exec_module(module := importlib.util.module_from_spec(spec))
    return module


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What the page in a browser finds out about itself."""
    command = [BROWSERS[0], "--headless", "--no-sandbox", "--disable-dev-shm-usage"]
    command += ["--disable-gpu", f"--user-data-dir={tmp_path_factory.mktemp('browser')}"]
    command += [
        "--virtual-time-budget=20000",
        "--dump-dom",
        f"{(LIVE / 'index.html').as_uri()}#test",
    ]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
    found = re.search(r'<script type="application/json" id="report">(.*?)</script>', done.stdout)
    assert found is not None, done.stderr[-2000:]
    return json.loads(found[1])


def test_it_is_built_from_its_sources(build):
    digest = re.search(r'<meta name="sources" content="(\w+)">', PAGE)
    assert digest is not None
    assert digest[1] == build.digest(), "changed since: run python docs/live/build.py"


def test_it_is_small_and_needs_no_network():
    assert len(PAGE.encode()) < 1_000_000
    # With this the browser loads nothing, even if scripts ask for it.
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', PAGE)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'")
    assert "http" not in policy[1]
    assert not re.findall(r'<(?:link|img|script)[^>]+(?:src|href)="(?!data:)', PAGE)


def test_the_licences_of_its_libraries_are_in_it():
    for owner in ("three.js authors", "Leon Sorokin", "The posegsa authors", "Rich Felker"):
        assert re.search(rf"Copyright (?:\(c\)|©) [^\n]*{owner}", PAGE), owner


@needs_browser
def test_after_a_turn_the_error_falls_again(report: dict):
    for name in ("recommended", "kalman", "observer"):  # which converge from any start
        found = report["turned"][name]
        assert found["after"] == pytest.approx([150, 5])
        for when in ("before", "again"):
            angle, distance = found[when]
            assert angle < 8
            assert distance < 0.5
    # It is meant for a start at the sensors' pose.
    assert report["turned"]["disturbed"]["before"][0] < 3


@needs_browser
def test_each_filter_can_be_selected(report: dict):
    assert len(report["selected"]) == len(FILTERS)
    for name, row in zip(FILTERS, report["selected"], strict=True):
        assert re.fullmatch(rf"{name}\s+[\d.]+ deg\s+[\d.]+ m", row.strip())


@needs_cc
@needs_browser
def test_webassembly_equals_the_c(report: dict, build, tmp_path: Path):
    experiments = build.write_headers(tmp_path)
    assert tuple(experiments) == FILTERS
    for name, experiment in experiments.items():
        header = (tmp_path / name / "posegsa.h").read_text(encoding="utf-8")
        options = ["-std=c99", "-O1", "-ffp-contract=off", *build.defines(experiment)]
        program = compile_c(tmp_path, header, LIVE / "filter.c", *options, compiler=COMPILERS[0])
        given = {key: base64.b64decode(text) for key, text in report["samples"][name].items()}
        done = subprocess.run(
            [str(program)], input=given["first"] + given["input"], check=True, capture_output=True
        )
        page = np.frombuffer(given["output"]).reshape(300, -1)
        native = np.frombuffer(done.stdout).reshape(3000, -1)[9::10]
        assert np.array_equal(np.isnan(page), np.isnan(native))
        largest = np.nan_to_num(np.abs(native)).max(axis=0)
        difference = np.nan_to_num(np.abs(page - native)).max(axis=0)
        assert np.all(difference <= 1e-12 * largest), (name, difference.max())
