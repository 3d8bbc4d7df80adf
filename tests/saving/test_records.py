"""The codec: records read back to the last bit, and anything else is refused."""

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypedDict

import numpy as np
import pytest
from helpers.results import history, trajectory
from pydantic import Field

from posegsa.errors import RunFolderError
from posegsa.optimisers import GSA, History
from posegsa.recordings.accuracy import Rmse
from posegsa.saving.records import from_json, to_csv, to_json
from posegsa.settings.arrays import Cost, Numbers

pytestmark = pytest.mark.quick

FILE = Path("record.json")


class Part(NamedTuple):
    """A nested record."""

    costs: Annotated[np.ndarray, Numbers("scenarios", allow="infinite")]
    measured: Annotated[np.ndarray, Numbers("scenarios", 2, allow="any")]
    diverged: Annotated[np.ndarray, Numbers("scenarios", dtype=bool)]


class Round(TypedDict):
    """The first of two kinds."""

    kind: Literal["round"]
    radius: float


class Square(TypedDict):
    """The second of two kinds."""

    kind: Literal["square"]
    sides: Annotated[list[float], Numbers(2)]


@dataclass(frozen=True)
class Whole:
    """A record with a field of every kind."""

    count: Annotated[int, Field(ge=0)]
    finite: float
    cost: Cost
    flag: bool
    name: str
    perhaps: int | None
    counts: Annotated[np.ndarray, Numbers(3, dtype=int)]
    words: dict[str, str]
    parts: dict[str, Part]
    pairs: list[tuple[int, float]]
    shape: Annotated[Round | Square, Field(discriminator="kind")]
    section: GSA


def whole(**values: Any) -> Whole:
    part = Part(
        costs=np.array([1.0, np.inf, 5e-324]),
        measured=np.array([[0.1, -0.0], [np.nan, -np.inf], [1 / 3, 1e308]]),
        diverged=np.array([True, False, False]),
    )
    made = Whole(
        count=3,
        finite=0.1,
        cost=np.inf,
        flag=False,
        name="tuned, of course",
        perhaps=None,
        counts=np.array([1, -2, 2**62]),
        words={"a": "b"},
        parts={"one": part, "other": part._replace(costs=np.array([3.0, 4.0, 5.0]))},
        pairs=[(1, 2.5), (2, 3.0)],
        shape={"kind": "square", "sides": [1.0, 2.0]},
        section=GSA(g0=7.0),
    )
    return replace(made, **values)


def read(text: str) -> Whole:
    return from_json(Whole, text, 5, FILE)


def assert_equal(a: Any, b: Any) -> None:
    """Whether two values are equal: the same types and dtypes, arrays to the last bit."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes() or np.isnan(a).any()
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_equal(a[key], b[key])
    elif isinstance(a, Part):
        assert_equal(a._asdict(), b._asdict())
    elif isinstance(a, Whole):
        assert_equal(vars(a), vars(b))
    else:
        assert a == b


# JSON ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "record", [whole(), whole(perhaps=4, cost=-0.0, shape={"kind": "round", "radius": 2.0})]
)
def test_a_record_comes_back_bit_for_bit(record):
    text = to_json(record, 5)
    assert_equal(read(text), record)
    assert "NaN" not in text.replace('"nan"', "")
    assert "Infinity" not in text


def test_a_changed_number_is_found_by_the_digest_and_read_on_demand():
    text = to_json(whole(), 5)
    altered = text.replace('"finite": 0.1', '"finite": 0.2')
    assert altered != text
    with pytest.raises(RunFolderError, match=r"record.json: was changed .*run it again"):
        read(altered)
    assert_equal(from_json(Whole, altered, 5, FILE, edited=True), whole(finite=0.2))
    # A digest that is gone, or another's, is none; the layout and the order of keys do not count.
    data = json.loads(text)
    for digest in (None, "", json.loads(to_json(whole(count=4), 5))["digest"]):
        with pytest.raises(RunFolderError, match="was changed"):
            read(json.dumps(data | {"digest": digest}))
    with pytest.raises(RunFolderError, match="was changed"):
        read(json.dumps({name: each for name, each in data.items() if name != "digest"}))
    assert_equal(read(json.dumps(dict(reversed(data.items())))), whole())


NUMBER = (None, True, "x", "1", [], {}, [1.0])
NO_NUMBER = (*NUMBER, "nan", "inf")


@pytest.mark.parametrize(
    ("path", "values"),
    [
        ("count", (*NO_NUMBER, -1, 1.5, 1.0)),
        ("finite", NO_NUMBER),
        ("cost", (*NUMBER, "nan", "Infinity")),
        ("flag", (None, 0, 1, "true", [])),
        ("name", (None, 3, True, [], "two\nlines", "\x1b[31mred", "\x9b1m")),
        ("perhaps", ("x", True, 1.5, [])),
        ("counts", (None, [], [1, 2], [1, 2, 3, 4], [1, 2, 3.0], [1, 2, True], [1, 2, 2**63], 1)),
        ("words", (None, [], {"a": 1}, {"a": "\x07"}, {"\x1b": "a"})),
        ("parts", (None, [], {"one": None}, {"\x1b[2J": 1})),
        ("parts.one.costs", (None, [], [1, 2, None], [1, 2, "nan"], [[1], [2], [3]])),
        ("parts.one.measured", ([[1, 2]], [[1], [2], [3]], [1, 2, 3], [[1, 2], [3], [4, 5]], [[]])),
        ("parts.one.diverged", ([0, 1, 0], [True], [True, False, None])),
        ("pairs", (None, [[1]], [[1, 2.0, 3]], [[1.5, 2.0]], [["1", 2.0]])),
        ("shape", (None, {}, [], {"kind": "oval"}, {"kind": ["round"]}, {"kind": "round"})),
        ("shape.sides", (None, "x", [1.0], [1.0, 2.0, 3.0], [1.0, "nan"], [1.0, True])),
        ("section", (None, [], {"g0": "x"}, {"g0": -1.0}, {"unknown": 1})),
    ],
)
def test_values_of_another_type_are_refused_by_the_path_of_their_field(path, values):
    *outer, last = path.split(".")
    for value in values:
        data = json.loads(to_json(whole(), 5))
        node = data
        for key in outer:
            node = node[key]
        assert node[last] != value or type(node[last]) is not type(value)
        node[last] = value
        # In a union the path also names the kind.
        where = path.replace("shape.", "shape.square.")
        with pytest.raises(RunFolderError) as refused:
            read(json.dumps(data))
        words = str(refused.value)
        assert words.startswith(f"record.json: {where}"), words
        assert all(c.isprintable() or c == "\n" for c in words)


def test_lengths_of_one_name_are_equal_throughout_a_record():
    parts = whole().parts
    longer = parts["other"]._replace(costs=np.ones(4), measured=np.ones((4, 2)))
    with pytest.raises(RunFolderError, match=r"other\.costs: shape \(4,\); .*'scenarios': 3"):
        read(to_json(whole(parts=parts | {"other": longer}), 5))


@pytest.mark.parametrize("name", [field.name for field in fields(Whole)])
def test_missing_and_unknown_fields_are_refused(name):
    data = json.loads(to_json(whole(), 5))
    with pytest.raises(RunFolderError, match=f"record.json: {name}_"):
        read(json.dumps(data | {f"{name}_": data[name]}))
    del data[name]
    with pytest.raises(RunFolderError, match=f"record.json: {name}: .*required"):
        read(json.dumps(data))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("[" * 10**5, "is not JSON"),
        ('{"schema": 5, "finite": NaN}', "is not JSON: NaN"),
        ('{"schema": 5, "finite": -Infinity}', "is not JSON: -Infinity"),
        ('{"schema": 5, "count": ' + "9" * 5000 + "}", "is not JSON"),
        ("[]", r"\[\].*object"),
        ("{}", r"schema = 'none'.*schema 5"),
        (
            '{"schema": 4, "version": "0.1"}',
            r"schema = 4,.*'0\.1'.*schema 5",
        ),
        ('{"schema": true, "version": "\\u001b"}', r"schema = True.*'\\x1b'"),
        ('{"schema": 5}', "count: .*; finite: .*9 more"),
    ],
)
def test_malformed_records_are_refused(text, said):
    with pytest.raises(RunFolderError, match=f"record.json: {said}"):
        read(text)


# Tables -------------------------------------------------------------------------------------------


def numbers_of(text: str) -> np.ndarray:
    """The numbers (rows, columns) of a table, as any program reads them."""
    return np.array([[float(cell) for cell in line.split(",")] for line in text.splitlines()[1:]])


def test_a_table_holds_every_bit():
    made = trajectory(7)
    # The trajectory of a filter that diverged is saved too.
    gain = np.array([np.inf, -np.inf, np.nan, -0.0, 5e-324, 1e308, 1 / 3])
    made = replace(made, gain=gain, euler=np.stack([gain] * 3, axis=1))
    text = to_csv(made)
    header, found = text.splitlines()[0].split(","), numbers_of(text)
    columns = (
        ("gain_1_s", gain),
        ("pitch_deg", gain),
        ("y_est_m", made.position_est[:, 1]),
        ("bias_error_v1", made.vector_bias_error[:, 1]),
    )
    for name, ours in columns:
        column = found[:, header.index(name)]
        np.testing.assert_array_equal(np.signbit(column), np.signbit(ours))
        np.testing.assert_array_equal(column, ours)


def test_single_precision_comes_back_too():
    seen = History(*(np.asarray(column, np.float32) for column in history(5)[:3]), np.arange(5))
    found = numbers_of(to_csv(seen))
    for ours, column in zip(seen, found.T, strict=True):
        np.testing.assert_array_equal(column.astype(ours.dtype), ours)


def test_single_precision_is_written_with_the_digits_that_it_has():
    seen = History(*(np.asarray([0.01, np.nan], np.float32),) * 3, np.arange(2))
    assert to_csv(seen).splitlines()[1:] == ["0.01,0.01,0.01,0", "nan,nan,nan,1"]


def test_a_table_may_count_its_rows():
    text = to_csv(history(5), counted="iteration")
    header, first, *_ = text.splitlines()
    assert header == ",".join(["iteration", *History._fields])
    assert first == "1,60.0,65.0,69.0,0"


def test_a_table_has_a_row_a_sample_under_names_with_units():
    made = trajectory(20)
    header, *rows = to_csv(made).splitlines()
    columns = header.split(",")
    assert len(rows) == 20
    assert len(set(columns)) == len(columns)
    table = dict(zip(columns, rows[7].split(","), strict=True))
    assert float(table["time_s"]) == made.time[7]
    assert float(table["yaw_est_deg"]) == made.euler_est[7, 2]
    assert float(table["z_m"]) == made.position[7, 2]
    assert float(table["bias_est_vy_m_s"]) == made.bias_est[7, 4]
    assert float(table["gain_used_1_s"]) == made.gain_used[7]
    assert float(table["scaled_rate"]) == made.rate[7]
    assert float(table["bias_est_v1_y"]) == made.vector_bias_est[7, 4]
    assert float(table["bias_error_v0"]) == made.vector_bias_error[7, 0]


@pytest.mark.parametrize("vectors", [0, 1, 3])
def test_a_table_has_columns_for_each_vector(vectors):
    biases, errors = np.ones((5, 3 * vectors)), np.full((5, vectors), 0.5)
    made = replace(trajectory(5), vector_bias_est=biases, vector_bias_error=errors)
    text = to_csv(made)
    header, found = text.splitlines()[0].split(","), numbers_of(text)
    named = [f"bias_est_v{i}_{axis}" for i in range(vectors) for axis in "xyz"]
    named += [f"bias_error_v{i}" for i in range(vectors)]
    assert [
        name
        for name in header
        if name.startswith(("bias_est_v0", "bias_est_v1", "bias_est_v2", "bias_error"))
    ] == named
    places = [header.index(name) for name in named]
    np.testing.assert_array_equal(found[:, places], np.concatenate([biases, errors], axis=1))


def test_a_field_with_a_default_may_be_missing_as_in_an_earlier_version() -> None:
    errors = Rmse(total=1.0, heading=0.5, inclination=0.25, position=0.1, samples=9, nees=6.5)
    stored = json.loads(to_json(errors, 5))
    del stored["nees"], stored["nis"]
    read = from_json(Rmse, json.dumps(stored), 5, FILE, edited=True)
    assert read == errors._replace(nees=None)
    del stored["total"]
    with pytest.raises(RunFolderError, match="total"):
        from_json(Rmse, json.dumps(stored), 5, FILE, edited=True)
