"""Strict YAML: values are read with their type, everything else is a problem, and no input is a traceback."""

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from operator_app.config.atomic import dump_strict
from operator_app.config.errors import ConfigError
from operator_app.config.strict_yaml import load_strict
from tests.oracles.identity import same


def parse_value(text):
    document = load_strict(f"key: {text}\n".encode(), "a.yaml")
    assert document.problems == ()
    return document.data["key"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12),
        ("-0.5", -0.5),
        ("1e-3", 0.001),
        ("1.e3", 1000.0),
        (".5", 0.5),
        ("+7", 7),
        ("true", True),
        ("FALSE", False),
        ("null", None),
        ("", None),
        ("~", None),
        ("'12'", "12"),
        ('"true"', "true"),
        ("[1, 2.0, a]", [1, 2.0, "a"]),
        ("{a: 1}", {"a": 1}),
        # Conversions of YAML 1.1 stay text.
        *(
            (text, text)
            for text in ("yes", "no", "on", "off", "Y", "12:30", "1:30:00", "2026-01-31")
        ),
        *((text, text) for text in ("010", "0o17", "0x1F", "0b11", "1_000", "1.2.3", "5 mm", "=")),
    ],
)
def test_plain_values_have_their_yaml_type(text, value):
    parsed = parse_value(text)
    assert parsed == value
    assert type(parsed) is type(value)


def test_keys_and_items_have_line_and_column():
    text = b"a: 1\nb:\n  c: 2\n  d:\n    - x\n    - {row: 5, e: 3}\n"
    document = load_strict(text, "a.yaml")
    assert document.marks[("b", "d", 1, "e")] == (6, 16)
    assert document.marks[("b", "d", 0)] == (5, 7)
    problem = document.problem(("b", "d", 1, "missing"), "is missing")
    assert (problem.line, problem.key) == (6, "b.d[row 5].missing")


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (b"", None),
        (b"\n# only a comment\n", None),
        (b"- a\n- b\n", 1),
        (b'<?xml version="1.0"?>\n<robot name="x"/>\n', 1),
        (b"just text\n", 1),
        (b"a: 1\n\tb: 2\n", 2),
        (b"a:\n\t- 1\n", 2),
        (b"\x89PNG\r\n\x1a\n\0\0", None),
        (b"a: 1\nb: \xff\xfe\n", 2),
        ("a: 1\n".encode("utf-16"), None),
        (b"a: 1\nb: \x07\n", 2),
        (b"a: &x [1]\nb: *x\n", 1),
        (b"a: 1\nb: !!float 3\n", 2),
        (b"a: 1\n---\nb: 2\n", 2),
        (b"a: [1\nb: 2\n", 2),
        (b"a: b: c\n", 1),
        (b'a: "\\U99999999"\n', None),
        (b"a: " + b"[" * 100 + b"]" * 100, 1),
        (b"a: 1\n" * 100_000, None),
    ],
    ids=lambda value: (
        value[:24].decode("ascii", "backslashreplace") if isinstance(value, bytes) else None
    ),
)
def test_invalid_document_gives_one_problem(data, line, approve):
    with pytest.raises(ConfigError) as caught:
        load_strict(data, "a.yaml")
    (problem,) = caught.value.problems
    assert problem.line == line
    approve(problem.text)
    assert problem.remedy


NOT_FINITE = (".nan", ".inf", "-.inf", "+.INF", "nan", "Infinity", "1e400")


@pytest.mark.parametrize(
    ("text", "key", "line"),
    [
        *((f"b: {{c: {number}}}\n", "b.c", 2) for number in NOT_FINITE),
        ("b: 1\nb: 2\n", "b", 3),
        ("? [1, 2]\n: 3\n", "", 2),
        ("<<: {c: 1}\n", "<<", 2),
        ("b: " + "9" * 50 + "\n", "b", 2),
        ('b: "\\ud800"\n', "b", 2),
    ],
)
def test_invalid_key_or_value_leaves_the_rest_readable(text, key, line, approve):
    document = load_strict(f"a: 1\n{text}z: 2\n".encode(), "a.yaml")
    (problem,) = document.problems
    assert (problem.key, problem.line) == (key, line)
    approve(problem.text)
    assert document.data["z"] == 2


def test_byte_order_mark_and_windows_line_ends_are_accepted_and_quotes_do_not_matter():
    document = load_strict(b"\xef\xbb\xbfa: 1\r\nb: x\r\n", "a.yaml")
    assert document.data == {"a": 1, "b": "x"}
    assert document.marks[("b",)] == (2, 1)
    (duplicate,) = load_strict(b"a: 1\n'a': 2\n", "a.yaml").problems
    assert duplicate.line == 2


# Characters with a meaning in YAML, so that examples reach the parser's later stages.
YAML_LIKE = st.text(
    alphabet="ab01.:-+[]{}#&*!|>'\"%@`,? \n\t\r\\~<=_\x85\u2028\ufeffé", max_size=60
)


@settings(max_examples=400, deadline=None)
@given(st.one_of(st.binary(max_size=80), YAML_LIKE.map(lambda t: t.encode("utf-8"))))
@example(b"%YAML 1." + b"9" * 5000 + b"\n---\na: 1\n")
@example(b'"\\xZZ"')
@example(b"a: |9999999999\n x\n")
@example("a: \ud7ff".encode())
@example(b"%TAG ! \n---\n")
def test_any_bytes_are_read_or_refused(data):
    try:
        document = load_strict(data, "a.yaml")
    except ConfigError as error:
        (problem,) = error.problems
        assert problem.text
    else:
        assert all(isinstance(key, str) for key in document.data)
        assert set(document.unreadable) <= set(document.marks)


TEXT = st.text(alphabet=st.characters(exclude_categories=("Cs",)), max_size=30)
LEAF = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**30), 10**30),
    st.floats(allow_nan=False, allow_infinity=False),
    TEXT,
    st.sampled_from(
        ["yes", "null", "1e5", "0x1F", "12", "nan", "~", "", "-", "a: b", "010", "=", "<<"]
    ),
)
TREE = st.recursive(
    LEAF,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=12,
)


@settings(max_examples=300, deadline=None)
@given(st.dictionaries(TEXT, TREE, max_size=4).filter(bool))
def test_written_values_are_read_back(data):
    document = load_strict(dump_strict(data), "a.yaml")
    assert document.problems == ()
    assert same(document.data, data)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "\ud800"])
def test_unreadable_value_cannot_be_written(value):
    with pytest.raises(ValueError, match="cannot be written"):
        dump_strict({"a": value})
