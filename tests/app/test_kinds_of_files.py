"""Kinds of files as users have them, each written here after the source of its format.

All hold the same four poses of a UR-like arm, so that one comparison judges all of them.
"""

import datetime
import io
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

from sklearn_raacmm import Arm
from sklearn_raacmm.app import TableError, read_table

RAD = np.array([
    [0.10, -1.20, 1.30, -0.40, 0.50, 0.60], [0.20, -1.10, 1.20, -0.30, 0.40, 0.50],
    [-0.30, -1.00, 1.10, -0.20, 0.30, 0.40], [0.40, -0.90, 1.00, -0.10, 0.20, -2.9],
])  # fmt: skip
DEG = np.rad2deg(RAD).round(4)
POINTS = np.array([[1.5, -200, 30], [100, 2, 300.25], [-1, 20, 3], [1000, 2000, 3000.125]])
LABELS = ["A", "A", "B", "B"]
NAMES = Arm.from_name("ur10").names
ALPHABETICAL = sorted(NAMES)  # as ROS drivers publish them
ORDER = [NAMES.index(name) for name in ALPHABETICAL]


def joined(rows, separator=","):
    return "".join(separator.join(map(str, row)) + "\n" for row in rows)


def with_points(text):
    """A robot's file says nothing of places; a tracker's points take their place."""
    return {"text": text, "options": {"points": "points"}}


Q = [f"q{i}" for i in range(1, 7)]


def as_table(header, values=DEG, separator=",", end="\n"):
    """Text of labels and values."""
    rows = [["station", *header]]
    rows += [[lab, *row] for lab, row in zip(LABELS, values, strict=True)]
    return "".join(separator.join(map(str, row)) + end for row in rows)


def of_places(text):
    """The names of a robot's points, by which two and two belong together."""
    for i, name in enumerate(["A_1", "A_2", "B_1", "B_2"]):
        text = text.replace(f"XP{i}=", f"{name}=").replace(f" j{i}:=", f" {name}:=")
        text = text.replace(f'P[{i + 1}:"p{i + 1}"]', f'P[{i + 1}:"{name}"]')
    return text


RTDE = [
    f"{name}_{i}" for name in ("target_q", "target_qd", "actual_q", "actual_qd") for i in range(6)
]
STATES = np.c_[RAD[:, ORDER], 0 * RAD, 9 * RAD]
PROGRAM = {
    # KUKA System Software 8.x, operating and programming instructions: structure E6AXIS in a .dat.
    "kuka krl": "DEFDAT TEST\n;FOLD points\n" + "".join(
        f"DECL E6AXIS XP{i}={{{','.join(f'A{j} {v}' for j, v in enumerate(r, 1))},E1 0.0}}\n"
        for i, r in enumerate(DEG)) + "ENDDAT\n",
    # KUKA.RobotSensorInterface 3.x: element AIPos, axis-specific actual positions.
    "kuka rsi": "".join(
        '<Rob Type="KUKA"><RIst X="1" Y="2" Z="3"/><AIPos '
        + " ".join(f'A{i}="{v}"' for i, v in enumerate(r, 1)) + "/></Rob>\n" for r in DEG),
    # ABB technical reference "RAPID instructions, functions and data types": jointtarget.
    "abb rapid": "MODULE m\n" + "".join(
        f"  CONST jointtarget j{i}:=[[{','.join(map(str, r))}],[9E+09,9E+09,9E+09]];\n"
        for i, r in enumerate(DEG)) + "ENDMODULE\n",
    # Fanuc, ASCII program (.ls), section /POS in joint representation.
    "fanuc ls": "/PROG TEST\n/POS\n" + "".join(
        f'P[{i}:"p{i}"]{{\n   GP1:\n\tUF : 0, UT : 1,\n'
        + ",\n".join(f"\tJ{j}= {v:11.4f} deg" for j, v in enumerate(r, 1)) + "\n};\n"
        for i, r in enumerate(DEG, 1)) + "/END\n",
}  # fmt: skip

# Name of the kind -> text of the file, its ending, and the options that a message names.
KINDS = {
    # Universal Robots, RTDE client library, csv_writer.py: blanks, names with _0 to _5, rad.
    "ur rtde": with_points(
        joined([["timestamp", *RTDE], *np.c_[range(4), 0.9 * RAD, 0 * RAD, RAD, RAD]], " ")
    ),
    # ROS 1, `rostopic echo -p /joint_states`: %time and fields with their numbers.
    "ros 1 echo -p": with_points(joined([
        ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id",
         *(f"field.{f}{i}" for f in ("name", "position", "velocity", "effort") for i in range(6))],
        *([1700000000 + i, i, 0, "base", *ALPHABETICAL, *row] for i, row in enumerate(STATES)),
    ])),
    # ROS 2, `ros2 topic echo --csv /joint_states`: the fields in order, and no header.
    "ros 2 echo --csv": with_points(
        joined([i, 12, "base", *ALPHABETICAL, *row] for i, row in enumerate(STATES))
    ),
    # PlotJuggler, "export to CSV": __time and the topics' paths.
    "plotjuggler": with_points(joined([
        ["__time",
         *(f"/joint_states/{n}/{f}" for n in ALPHABETICAL for f in ("effort", "position"))],
        *([i, *np.c_[9 * r, r].ravel()] for i, r in enumerate(RAD[:, ORDER])),
    ])),
    # Columns named by the joints of the arm, in any order, with motors' currents beside them.
    "names of joints": with_points(joined([
        ["t", *(f"{n} [rad]" for n in ALPHABETICAL), *(f"{n} current" for n in ALPHABETICAL)],
        *([i, *r, *(9 * r)] for i, r in enumerate(RAD[:, ORDER])),
    ])),
    **{kind: with_points(text) for kind, text in PROGRAM.items()},
    # RoboDK, "Robot calibration", file of measurements: joints, then the tracker's point.
    "robodk": {
        "text": joined([[*(f"J{i}" for i in range(1, 7)), "X", "Y", "Z"], *np.c_[DEG, POINTS]]),
        "options": {"points": ["X", "Y", "Z"]},
    },
    # Encoder counts, as counters of a data acquisition card have them.
    "encoder counts": {
        "text": joined([["seat", *(f"enc{i}" for i in range(6))], *(
            [lab, *row] for lab, row in zip(LABELS, (RAD / 2 / np.pi * 2**22).round().astype(int),
                                            strict=True))], ";"),
        "options": {"counts_per_turn": 2**22},
        "named": "--counts-per-turn",
    },
    # Loggers that end with comments, and those that begin with some: NumPy's savetxt.
    "closing comments": {"text": as_table(Q) + "# end of log, 4 rows\n# ok 17\n"},
    "numpy savetxt": {"text": "# measured in the lab\n# " + as_table([f"{q}_deg" for q in Q])},
    # Spreadsheet programs in English with a German computer: commas, quoted decimal commas.
    "quoted decimal commas": {
        "text": as_table(Q, [[f'"{v:.4f}"'.replace(".", ",") for v in row] for row in DEG]),
    },
    "joints in brackets": {"text": as_table([f"j[{i}]" for i in range(6)])},
    "joints and units in brackets": {"text": as_table([f"j[{i}] [rad]" for i in range(6)], RAD)},
    "gon": {"text": as_table([f"{q} [gon]" for q in Q], (RAD / np.pi * 200).round(5))},
    "mrad": {"text": as_table([f"{q} (mrad)" for q in Q], 1000 * RAD)},
    "turns": {"text": as_table([f"{q} [turns]" for q in Q], (RAD / 2 / np.pi).round(8))},
    "units in capitals": {"text": as_table([f"{q} [DEG]" for q in Q])},
    "blanks of any width": {"text": as_table(Q, separator="    ")},
    "a separator at the end": {"text": as_table(Q, end=",\n")},
    "rapid, names of places": {"text": of_places(PROGRAM["abb rapid"])},
    "krl, names of places": {"text": of_places(PROGRAM["kuka krl"])},
    "ls, names of places": {"text": of_places(PROGRAM["fanuc ls"])},
}  # fmt: skip


def write_points(path, kind="spatialanalyzer"):
    """Points by their names or without."""
    if kind == "spatialanalyzer":  # User's manual, "Exporting ASCII Formatted Points"
        lines = ["// SpatialAnalyzer", "// Collection Group Target X Y Z"]
        lines += [f"A, main, p{i}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(POINTS)]
    else:  # name, x, y, z in m with a header
        lines = ["Name\tX [m]\tY [m]\tZ [m]"]
        lines += [f"p{i}\t{x}\t{y}\t{z}" for i, (x, y, z) in enumerate(POINTS / 1000)]
    path.write_text("\n".join(lines) + "\n")
    return path


def in_rad(table):
    return np.deg2rad(table.angles) if table.angle_unit == "deg" else table.angles


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_text(kind, tmp_path):
    case = KINDS[kind]
    path = tmp_path / "log.txt"
    path.write_text(case["text"], encoding="utf-8")
    options = dict(case.get("options", {}))
    if options.get("points") == "points":
        options["points"] = write_points(tmp_path / "points.txt")
    if "named" in case:
        with pytest.raises(TableError, match=case["named"]):
            read_table(path, 6, joint_names=NAMES)
    table = read_table(path, 6, joint_names=NAMES, **options)
    np.testing.assert_allclose(in_rad(table), RAD, atol=3e-6)
    if "points" in options:
        np.testing.assert_allclose(table.points, POINTS, atol=1e-9)
    else:
        assert table.positions.tolist() == LABELS


@pytest.fixture
def book(tmp_path):
    """A spreadsheet as it is used: text with decimal commas, a title, a footer, two more sheets."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "Info"
    book.active.append(["operator", "Müller"])
    for name, factor in (("Messung", 1), ("Wiederholung", 0.5)):
        sheet = book.create_sheet(name)
        sheet.append(["Messprotokoll", None, datetime.datetime(2026, 11, 22)])
        sheet.append(["Kegel", *(f"q{i} [°]" for i in range(1, 7))])
        for label, row in zip(LABELS, factor * DEG, strict=True):
            sheet.append([label, *(f"{v:.4f}".replace(".", ",") for v in row)])
        sheet.append([])
        sheet.append(["geprüft:", "Müller"])
    book.save(tmp_path / "log.xlsx")
    return tmp_path / "log.xlsx"


def test_a_spreadsheet_as_it_is_used(book):
    table = read_table(book, 6)
    np.testing.assert_allclose(in_rad(table), RAD, atol=3e-6)
    assert table.positions.tolist() == LABELS
    assert table.rows.tolist() == [3, 4, 5, 6]
    printed = " ".join(table.notes)
    assert "sheet 'Messung' (--sheet takes another: Info, Wiederholung)" in printed
    assert "Left out from row 8 on, where the angles end: 'geprüft:'" in printed
    for sheet in ("Wiederholung", "3"):
        other = read_table(book, 6, sheet=sheet)
        np.testing.assert_allclose(in_rad(other), 0.5 * RAD, atol=3e-6)
    with pytest.raises(TableError, match="no sheet 'Blatt'; it has Info, Messung, Wiederholung"):
        read_table(book, 6, sheet="Blatt")
    with pytest.raises(TableError, match="no row with 6 numbers was found in the sheet Info"):
        read_table(book, 6, sheet="Info")


def rezipped(path, change):
    """The archive again, with one file's text changed."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, change(name, old.read(name)))
    path.write_bytes(buffer.getvalue())


def test_a_wrong_dimension_loses_no_row(book):
    """Some programs state fewer rows than they write; 4 rows must not become 2."""
    rezipped(book, lambda _, text: text.replace(b'ref="A1:G8"', b'ref="A1:G4"'))
    assert b'ref="A1:G4"' in zipfile.ZipFile(book).read("xl/worksheets/sheet2.xml")
    assert len(read_table(book, 6).rows) == 4


def test_damaged_files_get_a_sentence(book, tmp_path):
    rezipped(book, lambda name, text: text[:300] if "sheet2" in name else text)
    with pytest.raises(TableError, match="not a spreadsheet that can be read"):
        read_table(book, 6)
    for name, content, options, message in (
        ("long.csv", b"k;q1;q2\n" + b"x" * 200_000 + b";1;2\n", {}, "as a table: field larger"),
        ("long.csv", b"k;q1;q2\n", {"sheet": "1"}, "--sheet is for spreadsheets"),
        ("a.h5", bytes(range(256)), {}, r"is no table of text.*: save it as \.xlsx or CSV"),
        ("a.mat", b"MATLAB 7.3 MAT-file" + 105 * b" " + b"\0\2IM", {}, "7.3 are not read"),
        ("a.npz", b"PK", {}, "cannot be read"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(TableError, match=message):
            read_table(tmp_path / name, 2, **options)


STRUCTURED = np.array(
    [(lab, *row) for lab, row in zip(LABELS, RAD, strict=True)],
    dtype=[("station", "U3"), *((f"{q} [rad]", float) for q in Q)],
)
CELLS = np.array(LABELS, dtype=object)
# Name of the file, what writes it, and what it holds: NumPy's arrays and MATLAB's before 7.3.
ARRAYS = [
    ("a.npy", np.save, STRUCTURED),
    ("a.npz", lambda file, parts: np.savez(file, **parts), {"station": LABELS, "q": DEG}),
    ("a.mat", savemat, {"q": DEG, "station": CELLS, "fs": 50.0}),
    ("a.mat", savemat, {"station": CELLS} | {q: DEG[:, i] for i, q in enumerate(Q)}),
]


@pytest.mark.parametrize(("name", "write", "content"), ARRAYS)
def test_arrays(name, write, content, tmp_path):
    write(tmp_path / name, content)
    table = read_table(tmp_path / name, 6)
    np.testing.assert_allclose(in_rad(table), RAD, atol=3e-6)
    assert table.positions.tolist() == LABELS


def test_points_are_joined_by_a_column_or_by_order(tmp_path):
    order = [2, 0, 3, 1]
    header = ["point", *(f"q{i}" for i in range(1, 7))]
    rows = [[f"p{i}", *DEG[i]] for i in order]
    (tmp_path / "joints.csv").write_text(joined([header, *rows]))
    for kind in ("spatialanalyzer", "metres"):
        points = write_points(tmp_path / "points.txt", kind)
        table = read_table(tmp_path / "joints.csv", 6, points=points)
        np.testing.assert_allclose(table.points, POINTS[order], atol=1e-9)
        assert "matched by the column point" in table.notes[-1]
    np.savetxt(tmp_path / "bare.txt", POINTS)
    table = read_table(tmp_path / "joints.csv", 6, points=tmp_path / "bare.txt")
    np.testing.assert_allclose(table.points, POINTS, atol=1e-9)
    assert "in the order of the rows" in table.notes[-1]
    np.savetxt(tmp_path / "bare.txt", POINTS[:3])
    with pytest.raises(TableError, match=r"holds 3 points, .*joints\.csv 4 rows, and no column"):
        read_table(tmp_path / "joints.csv", 6, points=tmp_path / "bare.txt")
    (tmp_path / "two.txt").write_text("1,2\n3,4\n")
    with pytest.raises(TableError, match="no row with 3 numbers"):
        read_table(tmp_path / "joints.csv", 6, points=tmp_path / "two.txt")


def test_the_order_of_strange_names_is_not_guessed(tmp_path):
    """Alphabetical names of an arm whose joints have none: elbow first would be wrong silently."""
    (tmp_path / "log.csv").write_text(KINDS["ros 2 echo --csv"]["text"])
    options = {"points": write_points(tmp_path / "points.txt")}
    with pytest.raises(TableError, match=r"order from the base on with --angles.*\(elbow_joint\)"):
        read_table(tmp_path / "log.csv", 6, **options)
    named = [f"position{ALPHABETICAL.index(name)}" for name in NAMES]
    table = read_table(tmp_path / "log.csv", 6, angles=named, angle_unit="rad", **options)
    np.testing.assert_array_equal(table.angles, RAD)
    numbered = KINDS["ros 2 echo --csv"]["text"]
    for i, k in enumerate(ORDER):
        numbered = numbered.replace(ALPHABETICAL[i], f"joint_{k + 1}")
    (tmp_path / "log.csv").write_text(numbered)
    np.testing.assert_array_equal(read_table(tmp_path / "log.csv", 6, **options).angles, RAD)


def test_commanded_angles_alone_are_taken_and_other_columns_are_handed_on(tmp_path):
    """Labels may begin with the mark of a comment."""
    header = ["cone", *(f"target_q_{i}" for i in range(6)), "T [°C]", "tool"]
    rows = [["#" + lab, *row, 20.5, "ball"] for lab, row in zip(LABELS, DEG, strict=True)]
    (tmp_path / "log.csv").write_text(joined([header, *rows]))
    table = read_table(tmp_path / "log.csv", 6, position="cone", others=["t", "tool"])
    assert table.positions.tolist() == ["#A", "#A", "#B", "#B"]
    assert "Joint angles: target_q_0 to target_q_5." in table.notes
    assert table.others["t"].tolist() == [20.5] * 4
    assert table.others["tool"].tolist() == ["ball"] * 4
