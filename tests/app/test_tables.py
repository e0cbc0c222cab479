"""Tables as loggers and spreadsheets write them, and the sentences for what is wrong in them."""

import numpy as np
import pytest

from sklearn_raacmm.app import TableError, read_table
from sklearn_raacmm.app._files import read_lengths

ANGLES = np.array([[12.5, -3.25, 100.0], [13.0, -2.5, 99.125], [-170.0, 0.5, 98.0]])
LABELS = ["Kegel 1", "Kegel 1", "Kegel 1"]


@pytest.fixture
def write(tmp_path):
    def write(text, name="log.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return write


def lines(separator=";", decimal=",", header="Kegel;q1 [deg];q2 [deg];q3 [deg]"):
    rows = [header.replace(";", separator)]
    for label, angles in zip(LABELS, ANGLES, strict=True):
        cells = [label, *(f"{a:.3f}".replace(".", decimal) for a in angles)]
        rows.append(separator.join(cells))
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), (";", "."), ("\t", ","), (",", "."), ("|", ",")]
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_separators_decimal_signs_and_encodings(write, separator, decimal, encoding):
    header = "Höhe;Kegel;q1 [°];q2 [°];q3 [°]"
    text = lines(separator, decimal).split("\n", 1)[1]
    text = "".join(f"x{separator}{line}\n" for line in text.splitlines())
    path = write(header.replace(";", separator) + "\n" + text, encoding=encoding)
    table = read_table(path, 3)
    np.testing.assert_array_equal(table.angles, ANGLES)
    assert table.angle_unit == "deg"
    assert table.positions.tolist() == LABELS
    assert table.rows.tolist() == [2, 3, 4]
    printed = " ".join(table.notes)
    assert {".": "decimal points", ",": "decimal commas"}[decimal] in printed
    assert "Columns not used: Höhe." in printed


def test_what_loggers_put_around_the_table(write):
    """Lines above, units in a row of their own, a time stamp, quotes, empty lines and cells."""
    path = write(
        "Messprotokoll;Gerät Nr. 17\r\n;\r\nBediener: Müller\r\n\r\n"
        '"Datum";"J1";"J2";"J3";"Messpunkt"\r\n;[deg];[deg];[deg];-\r\n'
        '21.11.2026 13:20;"12,5";-3,25;100;A\r\n\r\n'
        "21.11.2026 13:21;13;\u22122,5;99,125;A;;\r\n;;;;\r\n"
        "21.11.2026 13:22;-170,0;+,5;9,8e1;A\r\n",
        encoding="utf-8",
    )
    table = read_table(path, 3)
    np.testing.assert_array_equal(table.angles, ANGLES)
    assert table.positions.tolist() == ["A"] * 3
    assert table.rows.tolist() == [7, 9, 11]
    assert "header in row 6" in table.notes[0]


def test_without_a_header_numbers_and_one_text(write):
    text = lines(" ", ".").split("\n", 1)[1].replace("Kegel 1", "K1")
    table = read_table(write(text), 3)
    np.testing.assert_array_equal(table.angles, ANGLES)
    assert table.positions.tolist() == ["K1"] * 3
    assert "no header" in table.notes[0]
    assert "Angles in degrees: they reach 170." in table.notes


def test_columns_can_be_named_or_numbered(write):
    path = write("a;b;c;where;s\n10;20;30;1;7\n11;21;31;1;7\n")
    for names in (["c", "A", "b"], ["3", "1", "2"]):
        table = read_table(path, 3, angles=names, position="where", angle_unit="rad")
        assert table.angles[0].tolist() == [30, 10, 20]
        assert table.positions.tolist() == ["1", "1"]
        assert table.angle_unit == "rad"


def test_points_of_a_tracker_in_metres_and_without_labels(write):
    path = write("p,q1/rad,q2/rad,X (m),Y (m),Z (m)\nA,1,2,0.5,1,1.5\nA,1,2,0.25,1,1.5\n")
    table = read_table(path, 2, points=["x", "y", "z"], position="p")
    np.testing.assert_allclose(table.points, [[500, 1000, 1500], [250, 1000, 1500]])
    assert table.angle_unit == "rad"
    path = write("q1 [rad];q2 [rad];x;y;z;note\n1;2;3;4;5;a\n1;2;3;4;6;b\n")
    table = read_table(path, 2, points=["x", "y", "z"])
    assert table.positions is None
    np.testing.assert_array_equal(table.points[:, 2], [5, 6])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("k;q1;q2\nA;0.1;0.2\nA;0.2;0.3\n", "degrees or in radians.*reach 0.3.*--unit deg or"),
        ("k;q1 [deg];q2 [rad]\nA;1;2\nA;1;2\n", "all be in degrees or all in radians"),
        ("k;q1 [inch];q2 [inch]\nA;1;2\nA;1;2\n", "all be in degrees or all in radians"),
        ("k;a;b;c\nA;1;2;3\nA;1;2;3\n", "which 2 columns hold the joint angles.*--angles q1,q2 "),
        ("q1;q2\n100;2\n100;2\n", "which column holds the label.*--position NAME.*q1, q2"),
        ("u;v;q1;q2\na;b;100;2\na;b;100;2\n", "which column holds the label"),
        ("k;q1;q2\nA;100;2\nA;nan;2\n", "row 3, column 'q1': 'nan' is not a number"),
        ("k;q1;q2\nA;100;2\n\nA;100;\n", "row 4, column 'q2': is empty"),
        ("k;q1;q2\nA;x;2\nA;100;2\n", "row 2, column 'q1': 'x' is not a number"),
        ("k;q1;q2\n;deg;deg\nA;;2\nA;100;2\n", r"row 3, column 'q1 \[deg\]': is empty"),
        ("k;q1;q2\nA;1,5;99\nA;1.5;99,5\n", "row 3, column 'q1': '1.5' .* decimal comma"),
        ("k;q1;q2\nA;100;2\n;100;3\n", "row 3, column 'k': the label is missing"),
        ("k;q1;q2\nA;100;2\nA;100\n", "row 3 has 2 cells, the table 3 columns"),
        ("k,q1,q2\nA,100,2\nA,1,5,2\n", "row 3 has 4 cells.*use semicolons"),
        ("k;q1;q2\ncone;100;2\ncone;100;3\ncome;1;2\n", "row 4: .*'come'.* Was 'cone' meant"),
        ("k;q;q\nA;100;2\nA;99;3\n", "the column 'q' is named twice"),
        ("k;q1;q2\n", "no row with 2 numbers"),
        ("", "no row with 2 numbers"),
    ],
)
def test_faults_are_named_by_row_and_column(write, text, message):
    with pytest.raises(TableError, match=f"(?s){message}"):
        read_table(write(text), 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"angles": ["q1"]}, "names 1 columns, the arm has 2 joints"),
        ({"angles": ["q1", "q9"]}, r"no column 'q9' \(--angles\); it has k, q1, q2, q2"),
        ({"angles": ["q1", "q2"]}, "2 columns 'q2'; --angles needs one"),
        ({"angles": ["q1", "q1"]}, "the column 'q1' is named twice, and no two joints have the"),
        ({}, "the column 'q2' is named twice, .* say with --angles, by numbers, .* k, q1, q2, q2"),
        ({"angles": ["q1", "3"], "position": "seat"}, "no column 'seat'"),
        ({"angles": ["q1", "3"], "points": ["x"] * 3}, r"no column 'x' \(--points\)"),
    ],
)
def test_wrong_names_list_the_right_ones(write, options, message):
    path = write("k;q1;q2;q2\nA;100;2;3\nA;100;2;3\n")
    with pytest.raises(TableError, match=message):
        read_table(path, 2, **options)


def test_lengths(write):
    expected = [("1", "2", 500.02, 0.01), ("2", "B", 300.0, 0.01)]
    assert read_lengths(write("von;bis;L [mm];s\n1;2;500,02;0,01\n2;B;300;0,01\n")) == expected
    assert read_lengths(write("1,2,500.02\n2,B,300\n"), sd=0.01) == expected
    for micro in ("um", "µm", "μm"):
        text = f"from;to;L [m];sd [{micro}]\n1;2;0,50002;10\n2;B;0,3;10\n"
        assert [(a, b, round(mm, 9), sd) for a, b, mm, sd in read_lengths(write(text))] == expected
    for text, message in (
        ("1;2;500,02\n", "row 1 has no standard deviation.*--length-sd"),
        ("1;2;500,02;1\n1;2\n", "row 2 must hold two labels and a length"),
        ("a;b\n", "no row with 1 numbers"),
    ):
        with pytest.raises(TableError, match=message):
            read_lengths(write(text))


def test_a_mistyped_heading_stands_in_the_note(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("k;q1;p2;q3\n" + "A;0.1;0.2;0.3\nA;0.2;0.3;0.4\n" * 3)
    notes = read_table(path, 3, angle_unit="rad").notes
    assert "Joint angles: the columns of numbers in their order, q1, p2, q3." in notes


def test_a_unit_is_no_name_of_a_joint(tmp_path):
    """The joint S and the s of times; columns are in no order of the joints."""
    path, joints = tmp_path / "log.csv", "SLURBT"
    header = ["time [s]", *(f"axis {joint} [deg]" for joint in joints[::-1])]
    rows = np.arange(28.0).reshape(4, 7)
    path.write_text("\n".join(";".join(map(str, row)) for row in [header, *rows]) + "\n")
    table = read_table(path, 6, labelled=False, joint_names=joints)
    np.testing.assert_array_equal(table.angles, rows[:, :0:-1])
