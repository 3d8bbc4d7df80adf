"""The report: one self-contained page that shows the result."""

import base64
import html
import re
from dataclasses import replace
from pathlib import Path

import jinja2
import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.pages import PICTURE, Page
from helpers.results import (
    ANGLES,
    FILTERS,
    OF_THE_OBSERVER,
    PARAMETERS,
    changed,
    consistent,
    contender,
    description,
    endurance,
    evaluation,
    result,
    trust,
)

import posegsa
from posegsa import config
from posegsa.errors import ArgumentError, RunFolderError
from posegsa.figures import evaluation_figures
from posegsa.figures import style as figure_style
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CONSTANT,
    EKF,
    OPEN_LOOP,
    SMOOTH,
    SWITCH,
    TUNED,
)
from posegsa.judging.result import Result
from posegsa.report import report_html, templates
from posegsa.report.numbers import cost, number
from posegsa.report.sentences import filter_words

pytestmark = pytest.mark.quick


def page(given: Result | None = None, pictures=None) -> Page:
    return Page(report_html(given or result(), pictures or {"costs": PICTURE}))


def values(cell: str) -> list[float]:
    """The numbers in a cell."""
    cell = cell.replace("\u2212", "-").replace("\u221e", "inf")
    return [float(found) for found in re.findall(r"[-+]?(?:inf|\d[\d.]*(?:e[-+]\d+)?)", cell)]


def test_it_needs_nothing_else():
    text = report_html(result(), {"costs": PICTURE, "gain": PICTURE})
    assert text.startswith("<!doctype html>")
    assert "http:" not in text
    assert "https:" not in text
    found = Page(text).elements
    assert not {tag for tag, _ in found} & {"script", "link", "iframe", "object", "base", "form"}
    for _, attributes in found:
        assert "href" not in attributes
        assert not any(name.startswith("on") for name in attributes)
        assert attributes.get("src", "data:").startswith("data:")
    assert "url(" not in text
    assert "@import" not in text
    assert not re.search(r"{{|{%|{#|%}|#}", text), "every place of the template is filled"


def test_pictures_are_inside_the_page_with_words():
    found = page(pictures=dict.fromkeys(("costs", "bands", "rules", "convergence"), PICTURE))
    pictures = [attributes for tag, attributes in found.elements if tag == "img"]
    assert len(pictures) == 4
    for attributes in pictures:
        data = attributes["src"].removeprefix("data:image/png;base64,")
        assert base64.b64decode(data) == PICTURE
        assert len(attributes["alt"]) > 20
    captions = [tag for tag, _ in found.elements if tag == "figcaption"]
    assert len(captions) == 4


def test_it_is_structured_for_all_readers():
    found = page().elements
    assert ("html", {"lang": "en"}) in found
    assert any(a.get("name") == "viewport" for _, a in found)
    tags = [tag for tag, _ in found]
    assert tags.count("h1") == tags.count("title") == tags.count("main") == 1
    assert tags.count("h2") >= 7
    assert tags.count("table") == tags.count("caption")
    assert all(a.get("scope") in ("col", "row") for tag, a in found if tag == "th")
    boxes = [a for tag, a in found if a.get("class") == "scroll"]
    assert len(boxes) == tags.count("table"), "each table scrolls in a box of its own"
    assert all(a["role"] == "region" and a["aria-label"] and a["tabindex"] == "0" for a in boxes)


def test_the_table_of_costs_is_the_evaluation():
    given = evaluation()
    head, *rows = page(result(evaluation=given)).table("Cost on 40 held-out scenarios")
    assert head[:5] == ["Contender", "Mean", "95 % interval", "Median", "95th percentile"]
    assert [row[0] for row in rows] == list(OF_THE_OBSERVER)
    for name, mean, ends, median, high, worst, minus, its_ends, diverged, searched in rows:
        costs = given.contenders[name].metrics.cost
        expected = [
            *given.cost(name),
            *(np.median(costs), np.quantile(costs, 0.95, method="higher"), np.max(costs)),
        ]
        shown = [number for cell in (mean, ends, median, high, worst) for number in values(cell)]
        np.testing.assert_allclose(shown, expected, atol=0.0051)
        assert (diverged, searched) == ("0.0", str(given.contenders[name].filter.evaluations))
        if name == TUNED:
            assert minus == its_ends == ""
        else:
            shown = values(minus) + values(its_ends)
            np.testing.assert_allclose(shown, given.difference(name), atol=0.0051)


def test_the_table_of_behaviour_is_the_evaluation():
    given = evaluation()
    head, *rows = page(result(evaluation=given)).table("Parts of the cost")
    for unit in ("[s]", "[deg]", "[cm]", "[rad/s]", "[m/s]"):
        assert any(unit in cell for cell in head)
    for name, *cells in rows:
        m = given.contenders[name].metrics
        expected = [
            *(np.mean(m.transient), np.mean(m.steady)),
            *(np.median(m.settling_attitude), np.median(m.settling_position)),
            *(np.mean(m.rms_attitude), 100 * np.mean(m.rms_position)),
            100 * np.mean(m.rms_distance),
            *(np.mean(m.bias_angular), np.mean(m.bias_linear)),
        ]
        digits = np.array([2, 2, 2, 2, 2, 1, 1, 3, 3])
        shown = [values(cell)[0] for cell in cells]
        assert (np.abs(np.subtract(shown, expected)) <= 0.51 * 10.0**-digits).all()


def test_training_stands_beside_held_out():
    def costs(level):
        return {"cost": np.linspace(level - 1, level + 1, 40)}

    given = evaluation()
    for name, level in ((TUNED, 43.0), (CONSTANT, 45.0)):
        given = changed(given, name, **costs(level))
    text = page(result(evaluation=given)).text
    assert_states(text, "43.00", "training 41.25", "training 45.00", "53.5", "\u22122.00")


def test_it_opens_with_what_the_run_was_for_and_what_to_do_next():
    better = changed(evaluation((TUNED, CONSTANT)), TUNED, cost=np.linspace(1, 2, 40))
    better = changed(better, CONSTANT, cost=np.linspace(4, 4.5, 40), bias_linear=np.full(40, 0.25))
    better = changed(better, TUNED, bias_linear=np.full(40, 0.5))
    text = page(result(evaluation=better)).text
    order = ("What it is for", "What is minimised", "What to do next", "Held out:")
    places = [text.index(words) for words in order]
    assert places == sorted(places)
    assert_states(text, "0.2 for each metre", "0.3 from 0 to 1 s", "1 from 4 to 59 s")
    assert_states(text, "bias error, linear", "0.500", "0.250 m/s")
    assert_states(
        text, "The tuned filter is better than the best constant gains", "posegsa evaluate RUN"
    )
    other = changed(better, TUNED, cost=np.linspace(5, 6, 40))
    text = page(result(evaluation=other, cost="mine.cost")).text
    assert_states(text, "constant: gain = 53.5", "mine.cost")
    assert "posegsa evaluate RUN" not in page().text


def test_it_says_which_other_filters_do_better():
    given = changed(evaluation(), TUNED, cost=np.linspace(10, 12, 40))
    for name in OF_THE_OBSERVER[1:]:
        given = changed(given, name, cost=np.linspace(13, 14, 40))
    text = page(result(evaluation=given)).text
    assert_states(text, "Best on 40 unseen scenarios: this filter", "Take this filter")
    assert_states(text, "The tuned filter is better than the best constant gains")
    given = changed(given, OPEN_LOOP, cost=np.linspace(9, 10.5, 40))
    found = page(result(evaluation=given))
    assert_states(found.text, "the best open-loop gains, which errs", "1.25 points of cost less")
    assert_states(found.text, "depends only on time")
    assert "The tuned filter is better than the best constant gains" not in found.text
    assert "posegsa export RUN --format c" in found.texts, "as code"


def test_where_nothing_is_worse_nothing_is_said_and_without_figures_no_box_is_left():
    same = evaluation((TUNED, CONSTANT))
    own = same.contenders[TUNED].metrics
    even = changed(same, CONSTANT, **own._asdict())
    found = page(result(evaluation=even), pictures={"none": PICTURE})
    assert "is worse than the best constant gains in" not in found.text
    boxes = [a for _, a in found.elements if a.get("class") == "figures"]
    assert len(boxes) == 1, "the tables of terms"


def test_warnings_are_shown_before_all_else():
    diverged = changed(evaluation(), TUNED, diverged=np.arange(40) < 3)
    bad = result(
        evaluation=diverged,
        trust=trust(sensitive=True, cost_float64=4800.0, uncovered=0.2),
        non_finite=17,
    )
    found = page(bad)
    assert len(bad.warnings()) == 4
    for warning in bad.warnings():
        assert warning[1:] in found.text
    assert found.text.index("SENSITIVE") < found.text.index("Held out, settled: tuned filter")
    assert any(a.get("class") == "warnings" for _, a in found.elements)
    assert_states(found.text, "Sensitive", "more than 1 %", "No rule fires", "20.0 %")


def test_nothing_is_warned_of_where_nothing_is_wrong():
    found = page()
    assert not any(a.get("class") == "warnings" for _, a in found.elements)
    assert_states(found.text, "Not sensitive", "within 1 %")


def test_an_oracle_signal_is_labelled():
    found = page(result("gain.signal=pose"))
    assert any(a.get("class") == "warnings" for _, a in found.elements)
    assert_states(found.text, "Signal pose")


def test_the_trust_checks_are_shown():
    rows = page(result(trust=trust(cost_float64=46.305))).table("Mean training cost")[1:]
    assert [row[0] for row in rows] == [
        *("float32 (used in the run)", "float64", "float32, initial pose changed by 1e-06"),
    ]
    assert [values(cost)[0] for _, cost, _ in rows] == [44.1, 46.305, 44.05]
    np.testing.assert_allclose([values(d)[0] for _, _, d in rows], [0, 5.0, -0.11])
    double = page(result("run.dtype=float64")).table("Mean training cost")
    assert [row[0] for row in double[1:3]] == ["float32", "float64 (used in the run)"]


def test_a_covariance_that_is_too_small_is_told():
    sure = changed(evaluation(), TUNED, nees_inside=np.full(40, 0.55))
    text = page(result(evaluation=sure)).text
    assert "inside its 95 % bound at 55 % of the samples. Do not trust its covariance." in text
    assert "too sure:" not in page().text


def test_every_rule_is_shown_with_its_weight():
    head, *rows = page().table("Rules")
    assert head[1:] == ["Error VS", "Error S", "Error M", "Error L", "Error VL"]
    assert [row[0] for row in rows] == ["Rate VS", "Rate S", "Rate M", "Rate L", "Rate VL"]
    printed = config.Experiment().fuzzy.rules  # from VL to VS both ways
    for r, row in enumerate(rows):
        for e, cell in enumerate(row[1:]):
            term, weight = cell.split(" ")
            assert term == printed[4 - r][4 - e]
            assert float(weight) == pytest.approx(trust().rule_weights[r, e], rel=0.05)
    assert_states(page().text, "2 of 25 rules", "1 %")


def test_every_parameter_is_shown_as_the_corner_that_it_is():
    found = page()
    cells = {}
    for caption in ("Input terms", "Output terms"):
        for term, *corners in found.table(caption)[1:]:
            for corner, cell in zip("abc", corners, strict=True):
                value, name = cell.split(" ")
                cells[name, term, corner] = float(value)
    names = dict(zip(config.PARAMETERS, PARAMETERS, strict=True))
    assert {key[0]: v for key, v in cells.items() if key[0] != "fixed"} == names
    for place in (("k1", "VS", "c"), ("k3", "S", "b"), ("k11", "VL", "a"), ("k22", "VL", "a")):
        assert place in cells


def test_the_whole_configuration_is_there():
    given = result("filter.substeps=4")
    text = html.unescape(report_html(given, {}))
    assert config.to_toml(given.experiment) in text
    assert "<details>" in text
    rows = page(given).table("Where the run was made")
    assert ["posegsa", "1.2.3"] in rows
    assert ["device", "1 x cpu"] in rows


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([], ['law = "gradient"', "gain_limit = 1.5", 'name = "mean"', "noise"]),
        (["search.optimiser=random_search"], ["Random search with 96 agents"]),
        (["objective.name=cvar"], ['name = "cvar", level = 0.75']),
        (["filter.law=printed", "filter.gain_limit=off"], ['"printed"', 'gain_limit = "off"']),
        (["filter.gamma=[1.0, 2.0]"], ["gamma = [1.0, 2.0]"]),
        (["gain.smoothing=2.0"], ["smoothing = 2.0"]),
        (["fuzzy.centroid=sampled"], ['centroid = "sampled", sampled_points = 101']),
        (["family.attitude_error=[0.0, 180.0]"], ["attitude_error = [0.0, 180.0]"]),
        (
            ["family.position_error=[0.0, 10.0]", "family.noise_scale=[0.5, 2.0]"],
            ["position_error = [0.0, 10.0]", "noise_scale = [0.5, 2.0]"],
        ),
        (["family.random_phase=true"], ["random_phase = true"]),
    ],
)
def test_what_was_run_is_described(settings, words):
    rows = page(result(*settings)).table("The run in words")
    text = " ".join(cell for row in rows for cell in row)
    for each in words:
        assert each in text


def test_every_setting_is_explained_where_it_is_shown():
    given = result("filter.law=printed")
    rows = {key: (value, said) for key, value, said in page(given).table("Settings")[1:]}
    assert rows["filter.law"] == ('"printed"', " ".join(described(config.ObserverConfig, "law")))
    assert rows["scenario.landmarks"][0].startswith("[{position = [0.5, ")
    for key, value in given.experiment.filter:
        assert f"filter.{key}" in rows, value
    shown = [
        a
        for tag, a in page(given).elements
        if tag == "abbr" and a["title"] == rows["filter.law"][1]
    ]
    assert len(shown) == 1


def described(section, key):
    return section.model_fields[key].description.split()


def test_the_held_out_set_is_named():
    assert_states(page().text, "own held-out set")
    assert_states(page(result(evaluation=evaluation(seed=7))).text, "held-out set number 7")


def test_what_the_contenders_are():
    rows = dict(page().table("What each contender is")[1:])
    assert list(rows) == list(OF_THE_OBSERVER)
    assert_states(rows[CONSTANT], "constant", "gain = 53.5")
    assert_states(rows[TUNED], "fuzzy", "k1 to k22")
    assert_states(rows[SWITCH], "before = 80", "after = 20", "time = 1.5", "learning_time = 0")
    assert_states(rows[OPEN_LOOP], "3 knots", "0 to 15 s", "open loop")
    assert_states(rows[EKF], "Kalman")
    also = description("constant", gain=2)._replace(also={"filter.gamma": 2.5})
    assert_states(filter_words(also), "constant", "gain = 2", "filter.gamma = 2.5")
    assert "posegsa evaluate" in page(result(evaluation=evaluation((TUNED, CONSTANT)))).text


def without_rules(*names: str, **values) -> Result:
    """A result whose filter has no rules, and another one."""
    judged = evaluation(names, initial_angle=ANGLES)
    own = judged.contenders[TUNED]._replace(filter=values["filter"])
    return result(
        evaluation=replace(judged, contenders=judged.contenders | {TUNED: own}),
        training=dict.fromkeys(names[:2], np.array([41.0, 43.0])),
        trust=trust(rule_weights=None, uncovered=None),
        **values,
    )


def without_configuration(found: Page) -> str:
    """The text of a page before the settings, which name whatever there is."""
    return found.text.partition("Every setting and what it means")[0]


NO_RULES = ("fuzzy", "Input terms", "Rules", "rules", "Some rule", "k1", "None")


def test_a_kalman_filter_is_shown_beside_itself_as_configured():
    given = without_rules(
        *(TUNED, AS_CONFIGURED, CONSTANT),
        experiment=config.override(config.Experiment(), ["filter.kind=kalman"]),
        filter=FILTERS[EKF],
        endurance=endurance(attitude=np.array([40.0, 6, 5, 9.5])),
    )
    found = page(given)
    assert not [words for words in (*NO_RULES, "gain K") if words in without_configuration(found)]
    assert_states(found.text, "Held out, settled: before tuning", "the filter before tuning")
    assert_states(found.text, "Kalman filter")
    assert_states(found.text, "Errors of the tuned filter and of the filter before tuning by time")
    assert_states(found.text, "worse than the filter before tuning: attitude")
    assert ["before tuning", "Kalman filter"] in found.table("What each contender is")
    settings = {key: value for key, value, _ in found.table("Settings")[1:]}
    assert settings["filter.kind"] == '"kalman"'


def test_a_constant_gain_is_shown_beside_a_smooth_one():
    given = without_rules(
        *(TUNED, SMOOTH),
        experiment=config.override(config.Experiment(), ["filter.schedule=constant"]),
        filter=FILTERS[CONSTANT],
    )
    found = page(given)
    assert not [words for words in NO_RULES if words in without_configuration(found)]
    assert_states(found.text, "the gain K", "Held out, settled: smooth gain K(e)", "training 42.00")


def test_it_says_what_the_filter_was_tuned_on():
    given = result()
    assert_states(page(given).text, "tuned on simulations", "minimised the cost on 24 training")
    judged = replace(given.search, tuned_on="recordings")
    text = page(replace(given, search=judged)).text
    assert_states(text, "tuned on recordings", "minimised the cost on recordings")
    assert "cost on 24 training scenario" not in text
    text = page(replace(given, search=None)).text
    assert_states(text, "not searched", "None: the filter has the numbers that were given")
    assert not [words for words in ("minimised the cost", "were tuned on") if words in text]


def test_other_tuned_numbers_are_shown_with_their_bounds():
    lines = '[{key = "filter.gamma", lower = 0.5, upper = 20.0, scale = "logarithmic"}]'
    settings = ("filter.gamma=5.0", f"parameters.also={lines}")
    found = page(result(*settings, also={"filter.gamma": 2.345678}))
    (row,) = found.table("Tuned values other than k1 to k22")[1:]
    assert row[0] == "filter.gamma"
    assert_states(found.text, "gamma = 2.346")
    assert values(row[1]) == [pytest.approx(2.345678, rel=1e-3)]
    assert not any(caption.startswith("Tuned values") for caption in page().tables)


def test_endurance_is_shown_by_windows_and_warned_of():
    given = endurance(attitude=np.array([40.0, 6, 5, 9.5]))
    found = page(result(endurance=given))
    head, *rows = found.table("Errors of the tuned filter")
    assert head[:3] == ["From [s]", "To [s]", "Attitude [deg]"]
    shown = [[values(cell)[0] for cell in row] for row in rows]
    np.testing.assert_allclose(
        shown,
        [[begin, end, a, ac, p, pc, d, dc] for begin, end, a, p, d, ac, pc, dc in given.rows()],
        atol=0.0051,
    )
    assert any(a.get("class") == "warnings" for _, a in found.elements)
    assert_states(found.text, "worse than the best constant gains", "attitude from 60 to 120 s")


def test_endurance_that_was_not_run_is_not_shown():
    without = result(endurance=None)
    found = page(without)
    assert "Long after" not in found.text
    assert not any(caption.startswith("Errors of the tuned filter") for caption in found.tables)
    assert "long after" not in without.summary()
    assert "long after" in result().summary()


def test_every_text_that_comes_from_data_is_escaped():
    evil = '<script>alert("1")</script>&amp;'
    given = evaluation((TUNED, CONSTANT))
    given.contenders[evil] = contender(0, filter=FILTERS[CONSTANT]._replace(also={evil: 1.0}))
    given = changed(given, evil, cost=np.linspace(1, 2, 40))  # the best, so the verdict names it
    found = page(result(evaluation=given, environment={evil: evil}, version=evil), {evil: PICTURE})
    assert not any(tag == "script" for tag, _ in found.elements)
    # Version twice, name in three tables and the verdict, a key of its filter, environment as key
    # and as value.
    assert found.text.count(evil) == 2 + 4 + 1 + 2
    template = templates().from_string('<p title="{{ evil }}">{{ evil }}</p>')
    assert Page(template.render(evil=evil)).elements == [("p", {"title": evil})]


def test_the_templates_mark_nothing_as_safe():
    folder = Path(posegsa.report.__file__).parent
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("*.html")]
    assert len(texts) == 6
    assert not any(re.search(r"\|\s*safe|autoescape", text) for text in texts)


def test_a_name_that_a_template_is_not_given_is_an_error():
    with pytest.raises(jinja2.UndefinedError, match="missing"):
        templates().from_string("{{ missing }}").render()


def test_infinite_costs_and_missing_intervals_are_shown_as_such():
    some = np.linspace(40, 50, 40)
    some[5] = np.inf
    nothing = np.full(40, np.inf)
    given = changed(evaluation(), TUNED, cost=some, transient=np.full(40, np.nan))
    given = changed(given, CONSTANT, cost=nothing, settling_attitude=nothing)
    bad = result(
        evaluation=given,
        training={TUNED: np.array([np.inf, 40.0]), CONSTANT: np.array([44.0, 46.0])},
        trust=trust(cost_float64=np.inf, cost_perturbed=np.nan, sensitive=True),
    )
    found = page(bad)
    rows = {row[0]: row for row in found.table("Cost on")}
    assert rows[TUNED][1:3] == ["\u221e", "\u2013"]
    assert rows[CONSTANT][1:8] == ["\u221e", "\u2013", *["\u221e"] * 3, "\u2013", "\u2013"]
    behaviour = {row[0]: row for row in found.table("Parts of the cost")}
    assert behaviour[TUNED][1] == "\u2013"
    assert behaviour[CONSTANT][3] == "\u221e"
    cells = [cell for rows in found.tables.values() for row in rows for cell in row]
    assert not any(re.search(r"\b(nan|inf)\b", cell) for cell in cells)
    assert_states(found.text, "training \u221e")


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (1.005, ".1f", "1.0"),
        (-0.8, "+.2f", "\u22120.80"),
        (0.8, "+.2f", "+0.80"),
        (-0.001, "+.2f", "0.00"),
        (np.nan, "+.2f", "\u2013"),
        (-np.inf, ".2f", "\u2212\u221e"),
        (3e-7, ".2g", "3e-07"),
    ],
)
def test_numbers_are_written_for_people(value, form, text):
    assert number(value, form) == text


def test_large_costs_are_written_short():
    assert cost(9999.9) == "9999.90"
    assert cost(123456.0) == "1.235e+05"
    assert cost(-123456.0, "+.2f") == "\u22121.235e+05"


def test_the_angles_are_explained_where_they_do_not_differ():
    assert_states(page().text, "174.8 deg")
    found = page(result(evaluation=evaluation(initial_angle=ANGLES)))
    assert "174.8 deg" not in found.text


def test_a_saved_run_has_its_figures_and_its_report(tmp_path, monkeypatch):
    monkeypatch.setattr(figure_style, "DPI", 15)
    whole = consistent()
    folder = posegsa.save(whole, tmp_path / "run")
    figures = {path.stem: path.read_bytes() for path in (folder / "figures").iterdir()}
    assert {"costs", "bands", "angles", "rules", "control_surface", "errors"} <= set(figures)
    text = (folder / "report.html").read_text(encoding="utf-8")
    sources = [attributes["src"] for tag, attributes in Page(text).elements if tag == "img"]
    shown = {base64.b64decode(source.partition(",")[2]) for source in sources}
    assert shown == set(figures.values()), "every figure is in the report"
    loaded = posegsa.load(folder)
    assert report_html(loaded, figures) == text
    # Only the named figures are kept, or none; earlier files are removed.
    for names in (["gain", "rules"], []):
        posegsa.save(whole, folder, overwrite=True, figures=names)
        assert {path.stem for path in (folder / "figures").iterdir()} == set(names)
    with pytest.raises(ArgumentError, match=r"figures.*gian.*costs, bands"):
        posegsa.save(whole, folder, overwrite=True, figures=["gian"])


def test_another_evaluation_replaces_figures_and_report(tmp_path, monkeypatch):
    monkeypatch.setattr(figure_style, "DPI", 15)
    monkeypatch.setattr(
        "posegsa.saving.result_files.draw",
        lambda result, _: {
            each.name: figure
            for each in evaluation_figures.FIGURES
            if (figure := each.draw(result)) is not None
        },
    )
    first = result(evaluation=evaluation(initial_angle=ANGLES))
    posegsa.save(first, tmp_path, overwrite=True)
    assert (tmp_path / "figures" / "angles.png").exists()
    judged = replace(first.on_scenarios, evaluation=evaluation(seed=3))
    posegsa.save(replace(first, on_scenarios=judged), tmp_path, overwrite=True)
    assert not (tmp_path / "figures" / "angles.png").exists(), "it would be another evaluation's"
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert_states(text, "held-out set number 3")
    assert "figure-costs" in text


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    (tmp_path / "figures").write_text("a file in the place of a folder")
    with pytest.raises(RunFolderError, match="Not a directory"):
        posegsa.save(result(), tmp_path)


@pytest.mark.parametrize(
    ("seed", "held_out", "facts"),
    [
        (None, 40, ["40 scenarios", "own held-out set"]),
        (None, 16, ["40 scenarios", "own held-out set", "16 scenarios"]),
        (5, 16, ["40 scenarios", "held-out set number 5"]),
    ],
)
def test_it_says_which_scenarios_judged(seed, held_out, facts):
    given = replace(evaluation(), seed=seed)
    text = page(result(f"run.held_out_scenarios={held_out}", evaluation=given)).text
    assert_states(text, *facts)
