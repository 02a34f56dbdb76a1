"""Poses files: lossless in both directions; each mistake is reported with line and column."""

import csv
import io

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from operator_app.config.csv_table import MOST_PROBLEMS
from operator_app.config.errors import ConfigError
from operator_app.config.poses_file import format_poses, load_poses, parse_poses, save_poses
from operator_app.safe_output import sanitized
from solver.chain.poses import PoseSet
from tests.oracles.identity import same

HEADER = "placement,pose,theta1_deg,theta2_deg,theta3_deg"
ROWS = ("1,1,10.5,-20,30", "1,2,11,-21,31.25", "2,1,12,-22,1e1")


def text(header=HEADER, rows=ROWS):
    return ("\n".join((header, *rows)) + "\n").encode()


def parse_invalid(data, joint_count=3):
    with pytest.raises(ConfigError) as caught:
        parse_poses(data, "p.csv", joint_count=joint_count)
    return caught.value.problems


def test_optional_columns_are_read_in_any_order():
    data = text(
        "note,pose,placement,theta2_deg,theta1_deg,sd1_deg,sd2_deg,samples,utc,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg",
        ('"a, ""b""",p1,3,20,10,0.1,0.2,32,2026-01-31T12:00:00Z,0.1,0.2,0.3,90,0,-90',),
    )
    poses = parse_poses(data, "p.csv", joint_count=2).poses
    np.testing.assert_array_equal(poses.q_rad, np.deg2rad([[10.0, 20.0]]))
    np.testing.assert_array_equal(poses.sd_rad, np.deg2rad([[0.1, 0.2]]))
    np.testing.assert_array_equal(poses.endpoint[0, :3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(poses.endpoint[0, 3:], np.deg2rad([90.0, 0.0, -90.0]))
    assert poses.keys == ((3, "p1"),)
    assert poses.samples.tolist() == [32]
    assert poses.notes == ('a, "b"',)
    assert poses.utc == ("2026-01-31T12:00:00Z",)


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbf" + text(),
        text().replace(b"\n", b"\r\n"),
        text().replace(b"\n", b"\r"),
        text() + b"\n\n",
        text().replace(b",", b" , "),
        text().replace(b"10.5", b"1.05e1").replace(b"31.25", b"+31.250"),
    ],
    ids=["bom", "crlf", "cr", "blank lines", "spaces", "other decimals"],
)
def test_equivalent_formatting_is_read_alike(data):
    reference = parse_poses(text(), "p.csv").poses
    poses = parse_poses(data, "p.csv").poses
    np.testing.assert_array_equal(poses.q_rad, reference.q_rad)
    assert poses.sha256() == reference.sha256()


# Case, file, joints of the arm; line, column and key of the problem.
BAD = [
    ("empty", b"", 3, None, None, ""),
    ("blank", b"\n  \n", 3, None, None, ""),
    ("quotes only", b'""\n', 3, None, None, ""),
    ("header only", text(rows=()), 3, None, None, ""),
    ("no header", text(ROWS[0], ROWS[1:]), 3, 1, None, ""),
    ("not a csv", b"schema: sarcal/arm/1\nname: a\n", 3, 1, None, ""),
    ("binary", b"PK\x03\x04\0\0\0\0", 3, None, None, ""),
    ("latin-1", text(rows=("1,\xe9,1,2,3",)).decode().encode("latin-1"),
     3, 2, None, ""),
    ("utf-16", text().decode().encode("utf-16"), 3, None, None, ""),
    ("semicolons", text().replace(b".", b",").replace(b",", b";"), 3, 1, None, ""),
    ("tabs", text().replace(b",", b"\t"), 3, 1, None, ""),
    ("six of seven", text("placement,pose," + ",".join(f"theta{j}_deg" for j in range(1, 7)),
                          ("1,1,1,2,3,4,5,6",)), 7, 1, None, "theta7_deg"),
    ("a gap", text("placement,pose,theta1_deg,theta3_deg", ("1,1,2,3",)), None, 1, None, "theta2_deg"),
    ("four of three", text(HEADER + ",theta4_deg", ("1,1,1,2,3,4",)), 3, 1, 6, "theta4_deg"),
    ("no pose column", text("placement,theta1_deg,theta2_deg,theta3_deg", ("1,1,2,3",)), 3, 1, None,
     "pose"),
    ("duplicate column", text(HEADER + ",theta2_deg", ("1,1,1,2,3,2",)), 3, 1, 6, "theta2_deg"),
    ("radians column", text(HEADER.replace("theta2_deg", "theta2_rad")), 3, 1, 4, "theta2_rad"),
    ("all in radians", text(HEADER.replace("_deg", "_rad")), 3, 1, 3, "theta1_rad, theta2_rad, theta3_rad"),
    ("misspelt column", text(HEADER.replace("placement", "placment")), 3, 1, 1, "placment"),
    ("foreign column", text(HEADER + ",colour", ("1,1,1,2,3,red",)), 3, 1, 6, "colour"),
    ("nameless column", text(HEADER + ",", ("1,1,1,2,3,",)), 3, 1, 6, "column 6"),
    ("one spread missing", text(HEADER + ",sd1_deg,sd2_deg", ("1,1,1,2,3,0,0",)), 3, 1, None, "sd3_deg"),
    ("spread of no joint", text(HEADER + ",sd1_deg,sd2_deg,sd3_deg,sd4_deg", ("1,1,1,2,3,0,0,0,0",)), 3, 1,
     9, "sd4_deg"),
    ("half an endpoint", text(HEADER + ",x_m,y_m", ("1,1,1,2,3,0,0",)), 3, 1, None, "z_m"),
    ("millimetres column", text(HEADER + ",x_mm,y_m,z_m", ("1,1,1,2,3,0,0,0",)), 3, 1, 6, "x_mm"),
    ("nan", text(rows=(ROWS[0], "1,2,nan,2,3")), 3, 3, 3, "theta1_deg"),
    ("inf", text(rows=(ROWS[0], "1,2,1,-inf,3")), 3, 3, 4, "theta2_deg"),
    ("overflow", text(rows=(ROWS[0], "1,2,1,1e999,3")), 3, 3, 4, "theta2_deg"),
    ("empty cell", text(rows=(ROWS[0], "1,2,1,,3")), 3, 3, 4, "theta2_deg"),
    ("word", text(rows=("1,1,1,two,3",)), 3, 2, 4, "theta2_deg"),
    ("underscore", text(rows=("1,1,1,1_0,3",)), 3, 2, 4, "theta2_deg"),
    ("foreign digits", text(rows=("1,1,1,\u0661,3",)), 3, 2, 4, "theta2_deg"),
    ("decimal comma", text(rows=('1,1,1,"2,5",3',)), 3, 2, 4, "theta2_deg"),
    ("counts", text(rows=("1,1,1,45034,3",)), 3, 2, 4, "theta2_deg"),
    ("millimetres", text(HEADER + ",x_m,y_m,z_m", ("1,1,1,2,3,350,0,0",)), 3, 2, 6, "x_m"),
    ("placement zero", text(rows=("0,1,1,2,3",)), 3, 2, 1, "placement"),
    ("placement 2^53 + 1", text(rows=("9007199254740993,1,1,2,3",)), 3, 2, 1, "placement"),
    ("placement 1e21", text(rows=("1000000000000000000000,1,1,2,3",)), 3, 2, 1, "placement"),
    ("no unit", text(HEADER + ",x_m,y_m,z_m,qw,qx,qy,qz", ("1,1,1,2,3,0,0,0,1,1,0,0",)), 3, None, None, ""),
    ("placement 1.5", text(rows=("1.5,1,1,2,3",)), 3, 2, 1, "placement"),
    ("no label", text(rows=("1, ,1,2,3",)), 3, 2, 2, "pose"),
    ("negative spread", text(HEADER + ",sd1_deg,sd2_deg,sd3_deg", ("1,1,1,2,3,0,-1,0",)), 3, 2, 7, "sd2_deg"),
    ("no sample", text(HEADER + ",samples", ("1,1,1,2,3,0",)), 3, 2, 6, "samples"),
    ("duplicate pose", text(rows=(*ROWS, "1,2,5,5,5")), 3, 5, 2, "pose"),
    ("short row", text(rows=(ROWS[0], "1,2,1,2")), 3, 3, None, ""),
    ("long row", text(rows=(ROWS[0], "1,2,1,2,3,4")), 3, 3, None, ""),
    ("open quote", text(rows=(ROWS[0], '1,2,"1,2,3')), 3, 3, None, ""),
    ("quote only", b'"', 3, 1, None, ""),
    ("next-line character", text(rows=(ROWS[0], "1,2,1,\x85,3")), 3, 3, 4, "theta2_deg"),
    ("a cell of 200,000 digits", b"placement,pose,theta1_deg\n1,1," + b"9" * 200_000, 1, 2, None, ""),
    ("a placement of 5000 digits", b"placement,pose,theta1_deg\n" + b"9" * 5000 + b",1,1", 1, 2, 1, "placement"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("data", "joints", "line", "column", "key"), [b[1:] for b in BAD], ids=[b[0] for b in BAD]
)
def test_one_mistake_gives_one_problem(data, joints, line, column, key, approve):
    (problem,) = parse_invalid(data, joints)
    assert (problem.line, problem.column, problem.key) == (line, column, key)
    approve(f"{problem.text}; {problem.remedy}")


def test_control_characters_of_a_column_name_are_escaped():
    with pytest.raises(ConfigError, match=r"\\x1b\[2J\\nred") as caught:
        parse_poses(b'placement,pose,theta1_deg,"\x1b[2J\nred"\n1,1,2,3\n', "p.csv")
    assert str(caught.value).isprintable()


def test_all_problems_are_listed_with_their_lines_up_to_a_limit():
    data = text(rows=("1,1,nan,2,", "x,2,1,2,3", "1,1", "1,4,1,2,3", "1,4,1,2,3"))
    assert [(p.line, p.key) for p in parse_invalid(data)] == [
        (2, "theta1_deg"),
        (2, "theta3_deg"),
        (3, "placement"),
        (4, ""),
        (6, "pose"),
    ]
    lines_in_notes = text(HEADER + ",note", ('1,1,1,2,3,"first\nsecond"', "1,2,1,2,oops,x"))
    assert [p.line for p in parse_invalid(lines_in_notes)] == [4]
    problems = parse_invalid(text(rows=("1,1,a,b,c",) * 1000))
    assert MOST_PROBLEMS <= len(problems) <= MOST_PROBLEMS + 3
    assert "the rest of the file was not read" in problems[-1].text


def test_suspected_radians_give_a_warning():
    rows = tuple(f"1,{k},0.1,{0.5 * k},-1.5" for k in range(8))
    (warning,) = parse_poses(text(rows=rows), "p.csv").warnings
    assert warning.code == "RADIANS_SUSPECTED"
    assert "3.5 deg" in warning.text
    assert parse_poses(text(rows=rows[:4]), "p.csv").warnings == ()
    assert parse_poses(text(rows=(*rows, "1,last,0.1,0.2,7")), "p.csv").warnings == ()


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (("2026-01-31T12:00:00Z", "yesterday"), "utc of pose 2 (placement 1) is 'yesterday', "),
        (("", "2026-01-31T12:00:00Z"), "utc of pose 1 (placement 1) is '', which is not a time"),
        (("2026-01-31T12:00:00Z", "2026-01-31T12:01:00"), "which has no zone, others have one"),
        (("2026-01-31T12:00:00Z", "2026-01-31T12:01:00+01:00"), ""),
        (("2026-01-31T12:00:00", "2026-01-31T12:01:00"), ""),
        (("", ""), ""),
    ],
)
def test_unreadable_times_give_a_warning(times, message):
    rows = tuple(f"1,{k},1,2,3,{utc}" for k, utc in enumerate(times, 1))
    warnings = parse_poses(text(HEADER + ",utc", rows), "p.csv").warnings
    assert [w.code for w in warnings] == (["UTC_UNREADABLE"] if message else [])
    assert all(w.text.startswith("p.csv: ") and message in w.text for w in warnings)


NOTES = st.text(
    alphabet=st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=8
)


@st.composite
def pose_sets(draw):
    """Any pose set that a file can represent: angles are doubles in degrees."""
    m, n = draw(st.integers(1, 5)), draw(st.integers(1, 8))

    def table(columns, low, high):
        return draw(arrays(np.float64, (m, columns), elements=st.floats(low, high)))

    endpoint_columns = draw(st.sampled_from([0, 3, 6]))
    endpoint = table(endpoint_columns, -10.0, 10.0) if endpoint_columns else None
    if endpoint is not None and endpoint_columns == 6:
        endpoint = np.concatenate((endpoint[:, :3], np.deg2rad(endpoint[:, 3:] * 18.0)), axis=1)
    present = st.booleans()
    return PoseSet(
        placement=np.array(draw(st.lists(st.integers(1, 9), min_size=m, max_size=m))),
        label=tuple(str(k) for k in draw(st.permutations(range(m)))),
        q_rad=np.deg2rad(table(n, -3600.0, 3600.0)),
        sd_rad=np.deg2rad(table(n, 0.0, 10.0)) if draw(present) else None,
        samples=np.arange(1, m + 1) if draw(present) else None,
        endpoint=endpoint,
        utc=("2026-01-31T12:00:00Z",) * m if draw(present) else None,
        notes=tuple(draw(st.lists(NOTES, min_size=m, max_size=m))) if draw(present) else None,
    )


@settings(max_examples=150, deadline=None)
@given(pose_sets())
def test_written_poses_are_read_back_bit_for_bit(poses):
    file = format_poses(poses)
    # Poses are read in the order of their numbers.
    numbered = [(placement, int(label)) for placement, label in poses.keys]
    poses = poses.at_poses(np.array(sorted(range(len(poses)), key=numbered.__getitem__)))
    read_back = parse_poses(file, "p.csv", joint_count=poses.joint_count).poses
    assert same(read_back, poses)
    assert read_back.sha256() == poses.sha256()


HOSTILE_TEXT = st.text(
    st.one_of(st.sampled_from("'=+-@\\u{}1b\x1b\u202e\ud800\r\n\t \0"), st.characters())
)


@settings(max_examples=300, deadline=None)
@given(HOSTILE_TEXT)
@example("=cmd|' /C calc'!A0")
@example("'=1")
@example("''")
@example("\\\x1b\\u{1b}\\\\u{41}")
@example("-5 deg")
def test_formulas_and_escapes_are_quoted_and_read_back(note):
    label = note.strip() or "1"
    placement, q_rad = np.array([1]), np.array([[-0.5]])
    file = format_poses(
        PoseSet(placement=placement, label=(label,), q_rad=q_rad, utc=(label,), notes=(note,))
    )
    rows = list(csv.reader(io.StringIO(file.decode(), newline="")))
    assert rows[1][0] == "1"
    assert float(rows[1][2]) < 0.0
    for cell in (rows[1][1], *rows[1][3:5]):
        assert not cell.lstrip().startswith(("=", "+", "-", "@"))
        assert not cell.startswith(("\t", "\r", "\n"))
        assert sanitized(cell, keep="\t\n") == cell
    read_back = parse_poses(file, "p.csv").poses
    assert (read_back.label, read_back.utc, read_back.notes) == ((label,), (label,), (note,))


def test_unquoted_formulas_and_escapes_are_read_unchanged():
    rows = ("1,-1,1,\x1bnote", "1,'tis,1,\\u{41}", "1,=a,1,\\u{110000}")
    poses = parse_poses(text("placement,pose,theta1_deg,note", rows), "p.csv").poses
    assert poses.label == ("-1", "'tis", "=a")
    assert poses.notes == ("\x1bnote", "\\u{41}", "\\u{110000}")


def test_saved_file_has_the_documented_header(tmp_path):
    poses = parse_poses(text(), "p.csv").poses
    save_poses(tmp_path / "p.csv", poses)
    lines = (tmp_path / "p.csv").read_text().splitlines()
    assert lines[0] == HEADER
    assert lines[1] == "1,1,10.5,-20.0,30.0"
    assert load_poses(tmp_path / "p.csv").poses.sha256() == poses.sha256()
    with pytest.raises(ConfigError, match=r"no such file; did you mean .*p\.csv\?"):
        load_poses(tmp_path / "q.csv")
