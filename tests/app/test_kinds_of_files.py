"""Kinds of files as users have them, each written here after the source of its format.

All hold the same four poses of a UR-like arm, so that one comparison judges all of them.
"""

import datetime
import io
import json
import re
import zipfile

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from sklearn_raacmm import Arm
from sklearn_raacmm.app import TableError, _commands, main, read_table
from sklearn_raacmm.app._tables import read_points

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


def markdown(text):
    """A table of Markdown of one of commas."""
    rows = [f"| {line.replace(',', ' | ')} |" for line in text.splitlines()]
    return "\n".join([rows[0], "|" + "---|" * (rows[0].count("|") - 1), *rows[1:], ""])


def of_places(text):
    """The names of a robot's points, by which two and two belong together."""
    for i, name in enumerate(["A_1", "A_2", "B_1", "B_2"]):
        text = text.replace(f"XP{i}=", f"{name}=").replace(f" j{i}:=", f" {name}:=")
        text = text.replace(f'P[{i + 1}:"p{i + 1}"]', f'P[{i + 1}:"{name}"]')
    return text


RTDE = [
    f"{name}_{i}" for name in ("target_q", "target_qd", "actual_q", "actual_qd") for i in range(6)
]
RECORDS = [
    {"place": label, "q": row.tolist(), "tcp": {"x": 1.5, "y": 2, "z": 3, "rx": 0}}
    for label, row in zip(LABELS, DEG, strict=True)
]


def lists(form, values=DEG):
    """A line for each pose, with its numbers where the form has {}."""
    rows = enumerate(zip(LABELS, values, strict=True))
    return "".join(
        form.replace("{}", ", ".join(map(str, row))).replace("LABEL", label)
        .replace("NUMBER", str(i)) + "\n" for i, (label, row) in rows
    )  # fmt: skip


def echo(begin, end, separator):
    """JointState messages, as the two generations of ROS echo them."""
    text = ""
    for i, row in enumerate(RAD[:, ORDER]):
        text += f"header:\n  seq: {i}\n  stamp:\n    secs: 14{i}\n  frame_id: ''\nname:"
        for cells in (ALPHABETICAL, row):
            text += begin + separator.join(map(str, cells)) + end
            text += "position:" if cells is ALPHABETICAL else "velocity: []\neffort: []\n---\n"
    return text


def sexagesimal(value):
    """An angle in degrees as theodolites show it."""
    seconds = round(abs(value) * 3600, 2)
    whole = f"{int(seconds // 3600)}°{int(seconds // 60 % 60):02d}'{seconds % 60:05.2f}"
    return f"-{whole}" if value < 0 else whole


EACH = ["A_1", "A_2", "B_1", "B_2"]  # names of single poses
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
    # Robots of several arms, and of several robots, put a name before those of the joints.
    **{f"names of joints behind {before}": with_points(joined([
        ["t", *(f"{before}{n}{unit}" for n in ALPHABETICAL)],
        *([i, *r] for i, r in enumerate(RAD[:, ORDER])),
    ])) for before, unit in (("left_", " [rad]"), ("r2_", " [rad]"))},
    "names of joints behind a slash": {  # which may part a unit, too
        "text": joined([
            ["t", *(f"ur/{n}" for n in ALPHABETICAL)],
            *([i, *r] for i, r in enumerate(RAD[:, ORDER])),
        ]),
        "options": {"points": "points", "angle_unit": "rad"},
    },
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
    # Programs that name places, and lists as Python, MATLAB and C++ print them.
    "doosan posj": {"text": lists("LABEL_NUMBER = posj({})")},
    "efort": with_points(lists("LOCAL VAR jointtarget jNUMBER = j:{{} ,0 }\t{EJ 0,0,0,0,0,0}")),
    "staubli dtx": with_points(
        '<?xml version="1.0"?>\n<Database><Datas><Data name="j" type="jointRx">\n'
        + "".join(f'<Value key="{i}" ' + " ".join(f'j{j}="{v}"' for j, v in enumerate(row, 1))
                  + " />\n" for i, row in enumerate(DEG)) + "</Data></Datas></Database>\n"),
    "yaskawa pulses": {
        "text": "/JOB\n//POS\n///POSTYPE PULSE\n///PULSE\n" + "".join(
            f"C0000{i}=" + ",".join(map(str, row)) + "\n"
            for i, row in enumerate((RAD / 2 / np.pi * 2**22).round().astype(int))) + "//INST\n",
        "options": {"counts_per_turn": 2**22, "points": "points"},
        "named": "counts of the encoders: say how many make a turn",
    },
    "lists of python": with_points(lists("[{}],")),
    "lists behind labels": {"text": lists("LABEL: [{}]")},
    "lists of joints and of points": {
        "text": "".join(f"({list(q)}, {list(p)})\n" for q, p in
                        zip(DEG.tolist(), POINTS.tolist(), strict=True)),
        "options": {"points": ["x", "y", "z"]},
    },
    "pairs": {"text": "".join(
        f"place {lab}\n" + " ".join(f"J{j}= {v:9.4f}" for j, v in enumerate(row, 1)) + "\n"
        for lab, row in zip("ABCD", DEG, strict=True)), "options": {"points": "points"}},
    # rostopic echo and ros2 topic echo: messages between lines of three dashes.
    "rostopic echo": with_points(echo(" [", "]\n", ", ")),
    "ros2 topic echo": with_points(echo("\n- ", "\n", "\n- ")),
    # Records: positions of the tool beside the joints are no angles.
    "json, records": {"text": json.dumps({"version": 2, "poses": RECORDS}, indent=1)},
    "json, a record a line": {"text": "".join(json.dumps(one) + "\n" for one in RECORDS)},
    "json, columns": {"text": json.dumps({"place": LABELS, "q": DEG.tolist()})},
    "json, rows by label": {"text": json.dumps({"A": DEG[:2].tolist(), "B": DEG[2:].tolist()})},
    "yaml, records": {"text": "# of a robot\nposes:\n" + lists("  - place: LABEL\n    q: [{}]")},
    "yaml, records of blocks": {"text": "".join(
        f"- place: '{lab}'\n  joints:\n" + "".join(f"    q{j}: {v}\n" for j, v in enumerate(row, 1))
        for lab, row in zip(LABELS, DEG, strict=True))},
    "yaml, rows by label": {"text": lists("pNUMBER: [{}]"), "options": {"points": "points"}},
    # Numbers and nothing else are the joints; a counter, a point and its label are not.
    "numbers alone": with_points(joined(DEG, " ")),
    "numbers behind a counter": with_points(joined(np.c_[1:5, DEG])),
    "numbers before a point": {
        "text": joined(np.c_[DEG, POINTS], "\t"), "options": {"points": ["7", "8", "9"]}
    },
    "sections": {"text": "q1 [deg],q2 [deg],q3 [deg],q4 [deg],q5 [deg],q6 [deg]\n" + "".join(
        f"# Position {lab}\n{joined(rows)}" for lab, rows in (("A", DEG[:2]), ("B", DEG[2:]))),
        "labels": ["Position A"] * 2 + ["Position B"] * 2},
    "units in the cells": {"text": as_table(Q, [[f"{v} deg" for v in row] for row in DEG])},
    "a unit above": {"text": "% units: radians\n" + as_table([f"axis {q}" for q in Q], RAD)},
    # Tables as pandas, R and MATLAB show them: names of rows have no header.
    "pandas, printed": with_points(pd.DataFrame(DEG, columns=Q).to_string() + "\n"),
    "pandas, json of columns": with_points(pd.DataFrame(DEG, columns=Q).to_json()),
    "pandas, json of the index": with_points(pd.DataFrame(DEG, columns=Q).to_json(orient="index")),
    "names of rows of R": with_points(joined([Q, *([f"r{i}", *row] for i, row in enumerate(DEG))])),
    "matlab": with_points("q = [\n" + joined(DEG, " ").replace("\n", ";\n") + "];\n"),
    "a list in a cell": with_points("t,q\n" + lists('NUMBER,"[{}]"')),
    "messages of a trajectory": with_points("points:\n" + lists(
        "- positions: [{}]\n  velocities: [0, 0, 0, 0, 0, 0]\n  time:\n    sec: NUMBER")),
    # TwinCAT Scope: a time before each value, and rows that describe each column.
    "twincat": with_points("Name\tScope\nFile\tx.svdx\n\n" + joined(
        [[cell for i in range(1, 7) for cell in ("Name", f"Axis{i}.ActPos")],
         ["SampleTime[ms]", 1] * 6, ["VariableSize", 8] * 6,
         *([x for v in row for x in (i, v)] for i, row in enumerate(DEG))], "\t")),
    # LabVIEW Measurement: a comment that most rows leave out, and a row of counts above.
    "labview": with_points("LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n\n" + joined(
        [["Channels", 6], ["Samples", *[90] * 6], ["***End_of_Header***"],
         ["X_Value", *(f"Encoder {i} (deg)" for i in range(1, 7)), "Comment"],
         *([i / 10, *row] for i, row in enumerate(DEG))], "\t")),
    "french": {"text": as_table([f"Axe {i} (degrés)" for i in range(1, 7)]), "encoding": "cp1252"},
    "chinese": {"text": as_table([f"关节{i}\uff08度\uff09" for i in range(1, 7)]),
                "encoding": "gb18030"},
    "japanese": {"text": as_table([f"関節{i} [度]" for i in range(1, 7)]), "encoding": "cp932"},
    # A page of notes, a program's own files, and exponents as Fortran writes them.
    "markdown": {"text": "# Log\n\nIn the lab.\n\n" + markdown(as_table(Q))},
    "markdown without bars": {"text": re.sub(r"(?m)^\| ?| ?\|$", "", markdown(as_table(Q)))},
    "org": {"text": markdown(as_table(Q)).replace("---|---", "---+---")},
    "toml": {"text": "".join(
        f'[[pose]]\nplace = "{lab}"\nq_deg = {row}\n\n'
        for lab, row in zip(LABELS, DEG.tolist(), strict=True))},
    "python, a dict a line": {"text": "".join(
        f"{dict(zip(['place', *Q], [lab, *row], strict=True))}\n"
        for lab, row in zip(LABELS, DEG.tolist(), strict=True))},
    "html": {"text": pd.DataFrame(DEG, LABELS, Q).rename_axis("place").reset_index().to_html()},
    "xml, attributes": {"text": "<?xml version='1.0'?>\n<log>\n" + "".join(
        f'<pose place="{lab}" ' + " ".join(f'j{j}="{v}"' for j, v in enumerate(row, 1)) + "/>\n"
        for lab, row in zip(LABELS, DEG, strict=True)) + "</log>\n"},
    "xml, elements": {"text": "<log>\n" + "".join(
        f"<pose><place>{lab}</place>" + "".join(f"<q{j}>{v}</q{j}>" for j, v in enumerate(row, 1))
        + "</pose>\n" for lab, row in zip(LABELS, DEG, strict=True)) + "</log>\n"},
    "xml, a pose and joints": {"text": "<log>" + "".join(
        f'<p place="{lab}"><tcp x="1.5" y="2" z="3" a="4" b="5" c="6"/><q '
        + " ".join(f'j{j}="{v}"' for j, v in enumerate(row, 1)) + "/></p>"
        for lab, row in zip(LABELS, DEG, strict=True)) + "</log>"},
    # trajectory_msgs: the names of the joints stand once.
    "json, names once": with_points(json.dumps(
        {"joint_names": ALPHABETICAL, "points": [{"positions": q} for q in RAD[:, ORDER].tolist()]}
    )),
    "yaml, names in each record": with_points("".join(
        f"- names: [{', '.join(ALPHABETICAL)}]\n  positions: [{', '.join(map(str, q))}]\n"
        for q in RAD[:, ORDER])),
    "angles and currents": {"text": as_table([*(f"i{i}" for i in range(1, 7)), *Q],
                                             np.hstack([1000 * DEG, DEG]))},
    "exponents of fortran": with_points("".join(
        " ".join(f"{v:.9E}".replace("E", "D") for v in row) + "\n" for row in DEG)),
    "ls, names of places": {"text": of_places(PROGRAM["fanuc ls"])},
    # Cells of instruments and of spreadsheets.
    "degrees, minutes, seconds": {"text": as_table(Q, [[sexagesimal(v) for v in r] for r in DEG])},
    "korean": {"text": as_table([f"관절{i}(도)" for i in range(1, 7)]), "encoding": "cp949"},
    "commanded and actual": {"text": as_table(
        [f"J{i} {what}" for i in range(1, 7) for what in ("cmd", "act")],
        [np.c_[row + 1, row].ravel() for row in DEG])},
    "a unit below each name": with_points(joined([Q, ["rad"] * 6, *RAD], "\t")),
    "statistics below": {"text": as_table(Q) + "".join(
        f"\n{name}," + ",".join(map(str, row)) for name, row in
        (("Mean", DEG.mean(0)), ("Std. Dev.", DEG.std(0)), ("Max", DEG.max(0))))},
    "statistics in the last column": {"text": joined([[*Q, "hole"], *(
        [*row, lab] for lab, row in zip(LABELS, DEG, strict=True)),
        [*DEG.mean(0), "Mean value"], [*DEG.std(0), "std"], [*np.ptp(DEG, axis=0), "Max - Min"]])},
    "statistics below each place": {"text": joined([["hole", *Q], *(
        row for lab, own in (("A", DEG[:2]), ("B", DEG[2:]))
        for row in [*([lab, *one] for one in own), ["average", *own.mean(0)]])])},
    "labels like statistics": {
        "text": as_table(Q).replace("\nA,", "\nMax,").replace("\nB,", "\nSum,"),
        "labels": ["Max"] * 2 + ["Sum"] * 2},
    "a word beside": {"text": joined([["operator", "hole", *Q], *(
        [name, lab, *row] for name, lab, row in zip("EEJE", "1122", DEG, strict=True))]),
        "labels": ["1", "1", "2", "2"]},
    "a sentence above": {"text": "# measured in turns by two people\n" + as_table(Q)},
    "names again above each place": {"text": "".join(
        f"cone {lab}\n{joined([Q, *rows])}\n" for lab, rows in (("A", DEG[:2]), ("B", DEG[2:]))),
        "labels": ["cone A"] * 2 + ["cone B"] * 2},
    "numbers of points behind places": {"text": joined(
        [["name", *Q], *([name, *r] for name, r in zip(EACH, DEG, strict=True))], " ")},
    # Programs, and what controllers and languages print.
    "urscript": with_points("def prog():\n" + lists(
        "  movej([{}], a=1.4)\n  sleep(0.5)\n  movel(p[1, 2, 3, 4, 5, 6])", RAD) + "end\n"),
    "melfa": with_points(lists("NUMBER0 Mov JP{NUMBER}").replace("{", "").replace("}", "")
                         + lists("JPNUMBER=({},0.00,0.00)")),
    "comau": {"text": "VAR\n" + "  A_0 : JOINTPOS FOR ARM[1]\n" * 4 + "BEGIN\n"
              + lists("  LABEL_NUMBER := {{}}") + "END\n"},
    "kawasaki": {"text": ".JOINTS\n" + lists("#LABEL_NUMBER {}").replace(",", "") + ".END\n",
                 "labels": ["#A", "#A", "#B", "#B"]},
    "c": with_points("const double q[4][6] = {\n" + lists("  {{}},") + "};\n"),
    "mathematica": with_points("{" + lists("{{}}, ").replace("\n", "").rstrip(", ") + "}\n"),
    "numpy, printed": with_points(np.array2string(DEG, max_line_width=40) + "\n"),
    "numpy, its repr": with_points("q_deg = " + repr(DEG)),
    "lists after their names": with_points(lists(
        "2024-03-01 12:00:0NUMBER,123 INFO angles: [{}] pose: [1, 2, 3, 4, 5, 6]")),
    "lua": {"text": lists('  {name = "LABEL_NUMBER", joint = {{}}, pose = {1, 2, 3, 4, 5, 6}},')},
    "names of joints behind places": {"text": "".join(
        f"{lab}: " + ", ".join(f"{n}={v}" for n, v in zip(NAMES, row, strict=True)) + "\n"
        for lab, row in zip(LABELS, DEG, strict=True))},
    "names before numbers": {
        "text": "".join(
            f"PT {i} " + " ".join(f"{n} {v}" for n, v in zip([*"XYZ", *Q], row, strict=True)) + "\n"
            for i, row in enumerate(np.c_[POINTS, DEG])),
        "options": {"points": ["x", "y", "z"]}},
    "sections of an ini file": {"text": "".join(
        f"[{name}]\n" + "".join(f"J{j}={v}\n" for j, v in enumerate(row, 1)) + "\n"
        for name, row in zip(EACH, DEG, strict=True))},
    "lists in cells": with_points("time,name,position\n" + "".join(
        f'{i},"{ALPHABETICAL}","{row.tolist()}"\n' for i, row in enumerate(RAD[:, ORDER]))),
    "json, names of columns": with_points(json.dumps(
        {"columns": Q, "index": [*range(4)], "data": DEG.tolist()})),
    "json, true and false": {"text": json.dumps(
        [one | {"in range": bool(i % 3)} for i, one in enumerate(RECORDS)])},
    "json lines, torques, too": {"text": "".join(json.dumps(
        {"place": lab, "q": row.tolist(), "dq": [0.5] * 6, "tau_J": [1.5] * 6}) + "\n"
        for lab, row in zip(LABELS, DEG, strict=True))},
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
    path.write_text(case["text"], encoding=case.get("encoding", "utf-8"))
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
        assert table.positions.tolist() == case.get("labels", LABELS)


NOT_JOINTS = {
    "a pose of Staubli": ("X,Y,Z,O,A,T", "columns X, Y, Z, O, A, T are poses of the tool"),
    "a pose of Fanuc": ("x,y,z,w,p,r", "columns x, y, z, w, p, r are poses of the tool"),
    "a pose of a UR": ("x,y,z,rx,ry,rz", "columns x, y, z, rx, ry, rz are poses of the tool"),
    "a quaternion": ("tx,ty,tz,qx,qy,qz,qw", "columns tx, ty, tz, qx, qy, qz, qw are poses"),
    "a numbered pose": ("pose_0,pose_1,pose_2,pose_3,pose_4,pose_5", "which 6 columns"),
}


@pytest.mark.parametrize("kind", NOT_JOINTS)
def test_poses_of_the_tool_are_no_joint_angles(kind, tmp_path):
    names, sentence = NOT_JOINTS[kind]
    n = names.count(",") + 1
    poses = np.c_[POINTS, DEG[:, 3:], np.ones(4)][:, :n]
    (tmp_path / "log.csv").write_text(joined([names.split(","), *poses]))
    with pytest.raises(TableError, match=sentence):
        read_table(tmp_path / "log.csv", 6)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            as_table([f"{q} [deg]" for q in Q]) + "B" + ",-999" * 6,
            "row 6, column 'q1 .deg.': -999 stands in all columns",
        ),
        (f"# angles in deg\n{as_table(Q)}# angles in rad\nB{',0.1' * 6}\n", "units deg and rad"),
        (as_table(Q).replace("station", "status"), "which column holds the label"),
    ],
)
def test_what_could_be_read_wrongly_is_asked_for(text, sentence, tmp_path):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(TableError, match=sentence):
        read_table(tmp_path / "log.csv", 6)


def test_decimal_commas_in_attributes_lose_no_decimals(tmp_path):
    (tmp_path / "log.dtx").write_text(re.sub(r"(\d)\.(\d)", r"\1,\2", KINDS["staubli dtx"]["text"]))
    with pytest.raises(TableError, match="no row with 6 numbers was found"):
        read_table(tmp_path / "log.dtx", 6, labelled=False)


def test_numbers_beyond_two_turns_are_no_angles(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(joined([[f"p{i}" for i in range(1, 7)], *np.c_[POINTS, DEG[:, 3:]]]))
    with pytest.raises(TableError, match="reach 3000, more than two turns in degrees"):
        read_table(path, 6, labelled=False)
    assert read_table(path, 6, labelled=False, angle_unit="deg").angles.max() > 3000
    np.savetxt(tmp_path / "log.txt", np.c_[POINTS, DEG[:, 3:]])
    with pytest.raises(TableError, match="reach 3000, more than two turns"):
        read_table(tmp_path / "log.txt", 6, points=write_points(tmp_path / "points.txt"))
    (tmp_path / "move.script").write_text(lists("movel(p[{}], a=1.2)"))
    with pytest.raises(TableError, match="row 1 holds a pose of the tool"):
        read_table(tmp_path / "move.script", 6)
    (tmp_path / "job.jbi").write_text(
        "/JOB\n//POS\n///POSTYPE BASE\n///RECTAN\nC00000=1,2,3,4,5,6\n"
    )
    with pytest.raises(TableError, match="poses of the tool; joint angles are needed"):
        read_table(tmp_path / "job.jbi", 6)


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


def test_headings_between_rows_of_a_spreadsheet(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (Q, ["Position A"], *DEG[:2].tolist(), ["Position B"], *DEG[2:].tolist()):
        book.active.append(row)
    book.save(tmp_path / "log.xlsx")
    table = read_table(tmp_path / "log.xlsx", 6)
    np.testing.assert_allclose(in_rad(table), RAD, atol=3e-6)
    assert table.positions.tolist() == ["Position A"] * 2 + ["Position B"] * 2


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


def test_points_that_some_rows_lack_are_matched_by_their_names(tmp_path):
    rows = [[f"p{i}", *DEG[i]] for i in range(4)]
    (tmp_path / "joints.csv").write_text(joined([["id", *Q], *rows]))
    lines = [[f"p{i}", *POINTS[i]] for i in (3, 0, 2)] + [["p9", 1, 2, 3]]
    (tmp_path / "points.csv").write_text(joined([["id", "X", "Y", "Z"], *lines]))
    table = read_table(tmp_path / "joints.csv", 6, points=tmp_path / "points.csv")
    np.testing.assert_array_equal(table.points, POINTS[[0, 2, 3]])
    np.testing.assert_allclose(table.angles, DEG[[0, 2, 3]])
    assert table.rows.tolist() == [2, 4, 5]
    said = "column id. Rows without a point, left out: p1. Points without a row: p9."
    assert said in table.notes[-1]


# Points as instruments write them: text, and the columns where no names say which they are.
POINT_FILES = {
    "total station": (
        "HEADER\n  UNITS\n    LINEAR  METRE\n  END UNITS\nEND HEADER\n  POINTS(PointNo, PointID, "
        'East, North, Elevation, Code)\n    100, "OR1", , , , ""\n' + "".join(
            f'    10{i}, "p{i}", {x}, {y}, {z}, ""\n' for i, (x, y, z) in enumerate(POINTS / 1000))
        + "  END POINTS\n", None),
    "inches above": ("// Spatial Analyzer\n// Units: Inches, Degrees\nPoint Name,X,Y,Z\n" + joined(
        [f"p{i}", *point] for i, point in enumerate(POINTS / 25.4)), None),
    "names of columns": ("id;nominal;a;b;c\n" + joined(
        ([f"p{i}", 7, *point] for i, point in enumerate(POINTS)), ";"), "a,b,c"),
    "pairs under names": ("".join(
        f"p{i}\nCnt=1  X= {x} Y= {y} Z= {z} RotX= 1.5\n"
        for i, (x, y, z) in enumerate(POINTS)), None),
    "nominal, too": ("PtID,Nominal X,Nominal Y,Nominal Z,Actual X,Actual Y,Actual Z\n" + joined(
        [f"p{i}", *(point + 1), *point] for i, point in enumerate(POINTS)), None),
    "motive": ("Format Version,1.23,Length Units,Meters\n\n,,Marker,Marker,Marker\n,,1,1,1\n"
        "Frame,Time (Seconds),X,Y,Z\n" + joined(
        [i, i / 120, *point] for i, point in enumerate(POINTS / 1000)), None),
    "a row for each coordinate": ("Name,Axis,Nominal,Measured,Dev\n" + joined(
        [f"p{i}", axis, value + 1, value, -1]
        for i, point in enumerate(POINTS) for axis, value in zip("XYZ", point, strict=True)), None),
    "metres above": ("Tracker 1\nCoordinates in metres\n\n" + joined(
        ([f"p{i}", *point] for i, point in enumerate(POINTS / 1000)), " "), None),
    "units in m": ("# Units in m\nid,X,Y,Z\n" + joined(
        [f"p{i}", *point] for i, point in enumerate(POINTS / 1000)), None),
    "length units in inches": ("# length units in inches\nid,X,Y,Z\n" + joined(
        [f"p{i}", *point] for i, point in enumerate(POINTS / 25.4)), None),
    "a town above": ("# Measured in Berlin in May, in M. Smith's lab\nid,X,Y,Z\n" + joined(
        [f"p{i}", *point] for i, point in enumerate(POINTS)), None),
    "thousands parted": ("id;X;Y;Z\n" + joined(([f"p{i}", *(
        f"{value:,.4f}".replace(",", "_").replace(".", ",").replace("_", ".") for value in point)]
        for i, point in enumerate(POINTS)), ";"), None),
    "json": (json.dumps([{"name": f"p{i}", "measured": dict(zip("xyz", point, strict=True))}
                         for i, point in enumerate(POINTS.tolist())]), None),
}  # fmt: skip


@pytest.mark.parametrize("kind", POINT_FILES)
def test_kinds_of_points(kind, tmp_path):
    text, columns = POINT_FILES[kind]
    (tmp_path / "points.idx").write_text(text)
    (tmp_path / "joints.csv").write_text(
        joined([["id", *Q], *([f"p{i}", *r] for i, r in enumerate(DEG))])
    )
    points = f"{tmp_path / 'points.idx'}:{columns}" if columns else tmp_path / "points.idx"
    table = read_table(tmp_path / "joints.csv", 6, points=points)
    np.testing.assert_allclose(table.points, POINTS, atol=1e-9)
    assert len(table.angles) == 4


def test_points_whose_columns_nothing_names_are_asked_for(tmp_path):
    (tmp_path / "joints.csv").write_text(joined([Q, *DEG]))
    (tmp_path / "points.csv").write_text("id,u,v\n1,2,3\n")
    with pytest.raises(TableError, match=r"Say it with --points points\.csv:X,Y,Z"):
        read_table(tmp_path / "joints.csv", 6, points=tmp_path / "points.csv")


def test_joint_3_of_a_fanuc_is_shown_from_the_horizontal(tmp_path, monkeypatch, capsys):
    """Its own angle is J3 + J2, unless the arm's file says so already."""
    lines = [
        f"P[{i}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t"
        + ",\t".join(f"J{j}= {value:.3f} deg" for j, value in enumerate(row, 1))
        + "\n}};"
        for i, row in enumerate(np.vstack([DEG, DEG + 3]), 1)
    ]
    (tmp_path / "cal.ls").write_text("/PROG  CAL\n/POS\n" + "\n".join(lines) + "\n/END\n")
    points = "\n".join(f"{x},{y},{z}" for x, y, z in np.vstack([POINTS, POINTS + 9]).tolist())
    (tmp_path / "points.csv").write_text(f"x,y,z\n{points}\n")
    given = []

    def learn(arm, *rest, **more):
        given.append(arm)
        raise ValueError("nothing is learnt")

    monkeypatch.setattr(_commands, "learn_correction", learn)
    arm = Arm.from_name("irb120")
    for one in (arm, arm.replace(couplings=[(3, 2, 1)])):
        one.to_json(tmp_path / "arm.json")
        paths = {"--arm": "arm.json", "--points": "points.csv", "--out": "out"}
        words = [word for name, path in paths.items() for word in (name, str(tmp_path / path))]
        assert main(["learn", str(tmp_path / "cal.ls"), *words]) == 2
    said = capsys.readouterr().err
    assert [one.couplings for one in given] == [((3, 2, 1),)] * 2
    assert said.count("its own angle is J3 + J2") == 1


@pytest.mark.usefixtures("quick_model")
def test_the_axis_that_moves_the_base_is_found(tmp_path, capsys, monkeypatch):
    """A robot on a track: by how much and where to E1 moves it, in the tracker's frame."""
    # Zeros are searched for before, and no start finds any.
    monkeypatch.setattr("sklearn_raacmm.correction._zeros._STARTS", 5)
    arm, rng = Arm.from_name("irb120"), np.random.default_rng(0)
    angles, axis = rng.uniform(-1.2, 1.2, (40, 6)), rng.uniform(0, 2000, 40)
    points = arm.forward(angles) + np.outer(axis, [0.6, 0.8, 0]) + rng.normal(0, 0.02, (40, 3))
    rows = np.column_stack([np.rad2deg(angles), axis, points]).round(4).tolist()
    header = [*Q, "E1", "X", "Y", "Z"]
    (tmp_path / "log.csv").write_text(joined([header, *rows]))
    words = ["--arm", "irb120", "--points", "X,Y,Z", "--out", str(tmp_path / "out")]
    assert main(["learn", str(tmp_path / "log.csv"), *words]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(r"base by \(0\.(6|59999)\d*, 0\.(8|79999)\d*, \S+\) mm a unit", said)
    assert not (tmp_path / "out").exists()


def test_an_external_axis_that_moves_is_named(tmp_path):
    for column, moves in ((np.arange(4) * 500.0, True), (np.full(4, 85943.0), False)):
        (tmp_path / "log.csv").write_text(joined([[*Q, "E1"], *np.c_[DEG, column]]))
        table = read_table(tmp_path / "log.csv", 6, points=write_points(tmp_path / "points.txt"))
        said = "Column E1 varies by 1500: an external axis moves the base"
        assert (said in " ".join(table.notes)) == moves


def test_what_looks_like_a_kind_and_is_none(tmp_path):
    """Words before numbers, longer lists beside the joints, and a place called as a statistic."""
    path = tmp_path / "log.txt"
    path.write_text(
        joined(
            [
                ["a", "b", "c", "X", "Y", "Z"],
                *([f"point {i}", f"set {i + 1}", f"day {i + 2}", *p] for i, p in enumerate(POINTS)),
            ]
        )
    )
    np.testing.assert_allclose(read_points(path)[1], POINTS)
    frames = np.arange(48.0).reshape(4, 12)
    path.write_text(
        joined(
            [
                ["station", *Q, "frame"],
                *(
                    [lab, *q, f"[{' '.join(map(str, f))}]"]
                    for lab, q, f in zip(LABELS, DEG, frames, strict=True)
                ),
            ],
            ";",
        )
    )
    np.testing.assert_allclose(read_table(path, 6).angles, DEG)
    path.write_text(as_table(Q).replace("A,", "Range,").replace("B,", "total,"))
    assert read_table(path, 6).positions.tolist() == ["Range"] * 2 + ["total"] * 2


def test_a_line_for_each_joint(tmp_path):
    """Tables and arrays of MATLAB that lie on their side."""
    many = np.tile(DEG, (6, 1))
    rows = joined([f"J{i}", *column] for i, column in enumerate(many.T, 1))
    (tmp_path / "log.csv").write_text(rows)
    savemat(tmp_path / "log.mat", {"log": {"q": many.T, "t": np.arange(24.0)}})
    for name in ("log.csv", "log.mat"):
        table = read_table(tmp_path / name, 6, labelled=False)
        np.testing.assert_allclose(table.angles, many)
        assert table.angle_unit == "deg"


def test_the_order_of_strange_names_is_not_guessed(tmp_path):
    """Alphabetical names of an arm whose joints have none: elbow first would be wrong silently.

    Those of a UR are known: they have one order from the base on, in cells and in the header.
    """
    text = KINDS["ros 2 echo --csv"]["text"]
    (tmp_path / "log.csv").write_text(text)
    options = {"points": write_points(tmp_path / "points.txt")}
    table = read_table(tmp_path / "log.csv", 6, angle_unit="rad", **options)
    np.testing.assert_array_equal(table.angles, RAD)
    header, rows = [*ALPHABETICAL, "p"], RAD[:, [NAMES.index(name) for name in ALPHABETICAL]]
    in_header = [header, *([*row, label] for row, label in zip(rows, LABELS, strict=True))]
    (tmp_path / "header.csv").write_text(joined(in_header, ";"))
    np.testing.assert_array_equal(
        read_table(tmp_path / "header.csv", 6, angle_unit="rad").angles, RAD
    )
    (tmp_path / "log.csv").write_text(text.replace("elbow_joint", "bend_joint"))
    with pytest.raises(TableError, match=r"order from the base on with --angles.*\(bend_joint\)"):
        read_table(tmp_path / "log.csv", 6, **options)
    named = [f"position{ALPHABETICAL.index(name)}" for name in NAMES]
    table = read_table(tmp_path / "log.csv", 6, angles=named, angle_unit="rad", **options)
    np.testing.assert_array_equal(table.angles, RAD)
    for form in ("joint_{}", "fr3_joint{}"):  # the first number may be that of the robot
        numbered = text
        for i, k in enumerate(ORDER):
            numbered = numbered.replace(ALPHABETICAL[i], form.format(k + 1))
        (tmp_path / "log.csv").write_text(numbered)
        np.testing.assert_array_equal(read_table(tmp_path / "log.csv", 6, **options).angles, RAD)


def test_of_two_arms_none_is_taken(tmp_path):
    """A robot of two arms names the joints of both; the first in the file may be the wrong one."""
    names = [f"{side}_joint_{i}" for side in ("left", "right") for i in range(1, 7)]
    header = [*(f"name{i}" for i in range(12)), *(f"position{i}" for i in range(12)), "p"]
    both = np.hstack([RAD, RAD[::-1]])
    rows = [[*names, *row, label] for row, label in zip(both, LABELS, strict=True)]
    (tmp_path / "log.csv").write_text(joined([header, *rows]))
    with pytest.raises(TableError, match="say the order from the base on"):
        read_table(tmp_path / "log.csv", 6, position="p", angle_unit="rad")


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
