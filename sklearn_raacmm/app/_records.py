"""Rows of files that are no table: programs of robots, echoes of messages, lists and records.

What a file is, its content says, never the ending of its name.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import ast
import json
import re
import tomllib
from collections import Counter
from contextlib import suppress
from importlib.util import find_spec
from typing import Any
from xml.etree import ElementTree

_VALUE = r"([+-]?\d*\.?\d+(?:[eE][+-]?\d+)?)"
_IN_LIST = rf"(?:^|,)\s*{_VALUE}"
# The name of a record, where it has one. Bounded, so that no long cell takes minutes.
_NAMED = r"(?:\b(\w{1,80})\s?=\s?)?"
# Programs and logs of controllers: what they are, what their text holds in any case, which is found
# faster than a pattern, the unit of their angles, a record with its name and its body, and the
# joints in the body.
_PROGRAMS = (
    # KUKA System Software, KRL reference: structures AXIS and E6AXIS.
    (
        "KUKA KRL",
        ("{", "A1"),
        "deg",
        _NAMED + r"\{(?:E6AXIS:|AXIS:)?\s?(A1\s[^{}]*)\}",
        rf"A\d\s+{_VALUE}",
    ),
    # KUKA.RobotSensorInterface: element AIPos, the axes' actual positions.
    ("KUKA RSI", ("<AIPos",), "deg", r"<(AIPos)\s([^>]*)>", rf'A\d="{_VALUE}"'),
    # ABB, RAPID data types: jointtarget is [robax, extax].
    # Without a name it is told from other lists by the external axes that are not there, 9E9.
    (
        "ABB RAPID",
        ("[[", ":="),
        "deg",
        r"\b(\w{1,80})\s?:=\s?\[\[([^][]*)\]\s?,\s?\[[^][]*\]\]",
        _IN_LIST,
    ),
    (
        "ABB RAPID",
        ("[[", "9E"),
        "deg",
        r"()\[\[([^][]*)\]\s?,\s?\[[^][]*9[eE]\+?0?9[^][]*\]\]",
        _IN_LIST,
    ),
    # Fanuc: section /POS of an LS file in joint representation.
    (
        "Fanuc LS",
        ("P[", "J1"),
        "deg",
        r'P\[(\d+(?:\s*:\s*"[^"]*")?)\]\s*\{([^{}]*)\}',
        rf"J\d\s*=\s*{_VALUE}\s*deg",
    ),
    # Doosan, programming manual: posj(J1, ..., J6).
    ("Doosan posj", ("posj",), "deg", _NAMED + r"\bposj\s?\(([^()]*)\)", _VALUE),
    # Staubli VAL3: data of the type jointRx in a .dtx file.
    (
        "Staubli VAL3",
        ("<Value",),
        "deg",
        r'<Value key="(\w{1,80})"\s([^<>]*\bj1=[^<>]*)>',
        rf'j\d="{_VALUE}"',
    ),
    # Efort: a jointtarget is j:{J1, ..., J6, external axes}.
    ("Efort", (":{",), "deg", _NAMED + r"\b[jJ]:\{([^{}]*)\}", _VALUE),
    # Yaskawa, job with POSTYPE PULSE: the counts of the axes' encoders.
    ("Yaskawa JBI", ("PULSE",), "counts", r"(?m)^\s*(C\d{4,6})=([-+\d, ]+)$", _VALUE),
)
# Jobs whose points are positions of the tool, not of the joints.
_CARTESIAN_JOB = re.compile(r"(?m)^///(?:POSTYPE\s+(?:BASE|ROBOT|USER|TOOL)|RECTAN)\b")
# A record of a program stands within so many characters, or the file is none; and so many lines
# are looked at for lists and pairs.
HEAD_CHARACTERS = 1 << 20
_LOOKED_AT = 300
_BRACKETS = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")
_SPLIT = re.compile(r"\s*[,;]\s*|\s+")
_IS_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_PAIR = re.compile(rf"\b([A-Za-z_][\w.]{{0,40}})\s*[=:]\s*{_VALUE}(?![\w.])")
_COMMENT = re.compile(r"\s*(#|//|%|--)")
# Keys and aliases of YAML, and what it has for nothing, and for no number.
_KEY = re.compile(r"""[\s-]*("[^"]*"|'[^']*'|[^\s\[\]{},"'#:-][^\[\]{},"'#:]*):(\s|$)""")
_ALIAS = re.compile(r"(?m)(?:^|[\s\[,])\*\w+\s*[,\]\n]")
_NOTHING = ("~", "null", ".nan")
# Poses of the tool of URScript, and of MELFA, which has two brackets.
_POSE_IN_BRACKETS = re.compile(r"\bp\[|\)\s*\(")


def find_records(text, read, n_numbers):
    """What a file of text is, and its rows (number, cells), the names first; None of a table.

    `text` is the file's beginning, `read` a function that returns all of it. Of a file that holds
    poses of the tool where joints are needed, a ValueError says so.
    """
    for find in (_json, _program, _xml, _yaml, _lists, _pairs):
        if found := find(text, read, n_numbers):
            what, names, rows = found
            return what, [(0, names), *rows] if names else rows
    return None


def with_places(names, rows):
    """Header and rows (line, cells), whose first cell is a name; places that the names show added.

    Points of one place have one name, or are named by it: P1_1, P1_2, P2_1 and so on.
    """
    own = [re.sub(r'^\d+\s*:\s*"(.+)"', r"\1", cells[0]) for _, cells in rows]
    shorter = [re.sub(r"[\W_]*\d+\W*$", "", name) for name in own]
    for places, how in ((own, "its name"), (shorter, "its name without the last number")):
        counts = Counter(places)
        if len(counts) > 1 and min(counts.values()) > 1:
            pairs = zip(rows, places, strict=True)
            return [*names, f"position ({how})"], [(n, [*cells, one]) for (n, cells), one in pairs]
    return names, rows


# -- programs -------------------------------------------------------------------------------------


def _program(head, read, n_joints):
    """A program or log of a robot's controller that holds joint positions."""
    if head.lstrip().startswith("/JOB") and _CARTESIAN_JOB.search(head):
        raise ValueError("its points are poses of the tool; joint angles are needed: as PULSE.")
    for what, marks, unit, record, value in _PROGRAMS:
        if not (all(mark in head for mark in marks) and re.search(record, head)):
            continue
        text, rows, line, done = read(), [], 1, 0
        for match in re.finditer(record, text):
            values = re.findall(value, match[2])
            # Coupled or external axes may follow the robot's own.
            if len(values) >= n_joints:
                line, done = line + text.count("\n", done, match.start()), match.start()
                rows.append((line, [match[1] or f"line {line}", *values[:n_joints]]))
        if rows:
            names = ["name", *(f"A{i} [{unit}]" for i in range(1, n_joints + 1))]
            long = {"deg": "degrees"}.get(unit, unit)
            return f"{what}, {long}", *with_places(names, rows)
    return None


# -- lists in lines, and pairs of names and numbers -----------------------------------------------


def _numbers_in(text):
    """Numbers of a list, as text; None if something else is in it."""
    cells = [cell for cell in _SPLIT.split(text.strip()) if cell]
    return cells if cells and all(map(_IS_NUMBER.fullmatch, cells)) else None


def _lists(head, read, n_numbers):
    """Lines with a list of so many numbers in brackets, perhaps with a name and further lists."""
    some = [line for line in head.splitlines()[:_LOOKED_AT] if line.strip()]
    wanted = sum(any(len(one) == n_numbers for one in _lists_of(line)) for line in some)
    if wanted < 2 or 2 * wanted < len(some):
        return None
    rows: list[Any] = []
    header: Any = None
    for number, line in enumerate(read().splitlines(), 1):
        lists = _lists_of(line)
        if not lists:
            continue
        if n_numbers > 3 and _POSE_IN_BRACKETS.search(line):
            raise ValueError(f"row {number} holds a pose of the tool; joint angles are needed.")
        sizes = [len(one) for one in lists]
        names = _names_of_lists(sizes, n_numbers)
        header = header or names
        if names != header:
            raise ValueError(f"row {number} has lists of {sizes} numbers, others {n_numbers}.")
        name = re.split(r"[\[({]", line, maxsplit=1)[0].strip(" \t=:,;\"'")
        rows.append((number, [name, *(cell for one in lists for cell in one)]))
    if all(cells[0] == "" for _, cells in rows):
        rows = [(number, cells[1:]) for number, cells in rows]
        named = any("[" in name or name == "x" for name in header[1:])
        return "Lists in brackets", header[1:] if named else None, rows
    return "Lists in brackets", *with_places(header, rows)


def _lists_of(line):
    """Lists of two numbers or more in the brackets of a line."""
    found = (_numbers_in(text) for text in _BRACKETS.findall(line))
    return [one for one in found if one and len(one) > 1]


def _names_of_lists(sizes, n_numbers):
    """Names of the numbers of lists: joints where one has as many, a point where one has three."""
    names = ["name"]
    for k, size in enumerate(sizes, 1):
        if size == n_numbers and sizes.count(size) == 1:
            names += [f"joint[{i}]" for i in range(1, size + 1)] if size > 3 else list("xyz")
        elif size == 3 and sizes.count(3) == 1:
            names += "xyz"
        else:
            names += [f"list {k}[{i}]" for i in range(1, size + 1)]
    return names


def _pairs(head, read, n_numbers):
    """Lines of names with their numbers, such as X= 1.5 Y= 2 Z= 3, under lines that name them."""
    some = [line for line in head.splitlines()[:_LOOKED_AT] if line.strip()]
    keys = Counter(tuple(key for key, _ in _PAIR.findall(line)) for line in some)
    keys = {names: count for names, count in keys.items() if len(set(names)) >= n_numbers}
    if not keys or 3 * sum(keys.values()) < len(some):
        return None
    rows, heading = [], ""
    names = list(dict.fromkeys(name for line in keys for name in line))
    for number, line in enumerate(read().splitlines(), 1):
        pairs = dict(_PAIR.findall(line))
        if len(pairs) >= n_numbers:
            rows.append((number, [heading or f"row {number}", *(pairs.get(k, "") for k in names)]))
        elif line.strip() and not _COMMENT.match(line):
            heading = line.strip(" \t:;,")
    return "Names with numbers", *with_places(["name", *names], rows)


# -- records: JSON, YAML, echoes of messages ------------------------------------------------------


def _json(head, read, n_numbers):
    """Records of JSON, TOML or Python, of one document or of one in each line."""
    if head.lstrip()[:1] not in ("{", "[") and "\n[[" not in head:
        return None
    text = read()
    lines = [line for line in text.splitlines() if line.strip()]
    by_line = all(line.lstrip().startswith("{") for line in lines)
    for what, parse in (
        ("JSON", json.loads), ("TOML", tomllib.loads), ("Python", ast.literal_eval),
    ):  # fmt: skip
        for parts in ([text], *[lines] * by_line):
            with suppress(ValueError, SyntaxError, RecursionError, MemoryError):
                found = list(map(parse, parts))
                return _of_records(what, found[0] if len(found) == 1 else found, n_numbers)
    return None


def _xml(head, read, n_numbers):
    """Records of XML, each an element with attributes or simple elements; or rows of HTML."""
    if not head.lstrip().startswith("<") or "<!ENTITY" in (text := read()):
        return None
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml.*?\?>", "", text, flags=re.DOTALL))
    except ElementTree.ParseError:
        return None
    if rows := [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]:
        return "HTML", None, list(enumerate(rows, 1))
    found: dict[str, list[Any]] = {}
    for one in root.iter():
        simple = {part.tag: part.attrib or (part.text or "").strip() for part in one}
        found.setdefault(one.tag, []).append(one.attrib | simple)
    records = (_of_records("XML", each, n_numbers) for each in found.values())
    return max(
        filter(None, records), key=lambda one: (len(one[2]), len(one[1] or ())), default=None
    )


def _yaml(head, read, n_numbers):
    """Records of YAML: lists of them, or messages as `ros2 topic echo` writes them."""
    lines = [line for line in head.splitlines()[:_LOOKED_AT] if line.strip()]
    lines = [line for line in lines if not _COMMENT.match(line) or line.startswith("---")]
    plain = sum(bool(_KEY.match(line)) for line in lines[:5])
    if not lines or not (plain or lines[0].startswith("---")) or find_spec("yaml") is None:
        return None
    import yaml

    base: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)  # scalars stay text

    class Loader(base):
        def construct_mapping(self, node, deep=False):
            if max(Counter(key.value for key, _ in node.value).values(), default=1) > 1:
                raise yaml.YAMLError("a key stands twice")  # such as the label of each row
            return super().construct_mapping(node, deep)

    text = read()
    with suppress(yaml.YAMLError, RecursionError, TypeError):
        if not _ALIAS.search(text):  # aliases could expand without end
            found = [_cleaned(one) for one in yaml.load_all(text, Loader) if one]
            return _of_records("YAML", found[0] if len(found) == 1 else found, n_numbers)
    return None


def _cleaned(value):
    """A value of YAML: lists that blanks part, as NumPy prints them, and "" for what is nothing."""
    if isinstance(value, dict):
        return {key: _cleaned(one) for key, one in value.items()}
    if isinstance(value, list):
        parts = _numbers_in(value[0]) if len(value) == 1 and isinstance(value[0], str) else None
        return parts or [_cleaned(one) for one in value]
    return "" if value.lower() in _NOTHING else value


def _of_records(what, value, n_numbers):
    """Names and rows of a value that holds records somewhere; None if it holds none."""
    records = _records(value, n_numbers)
    flat = [_flattened(one) for one in records or ()]
    names = list(dict.fromkeys(name for one in flat for name in one))
    rows = []
    for number, one in enumerate(flat, 1):
        cells = [one.get(name, "") for name in names]
        rows.append((number, cells))
    counts = [sum(bool(_IS_NUMBER.fullmatch(str(cell))) for cell in cells) for _, cells in rows]
    if max(counts, default=0) < n_numbers:
        return None
    unnamed = all(re.fullmatch(r"\[\d+\]", name) for name in names)
    return f"{what}, record by record", None if unnamed else names, rows


def _records(value, n_numbers):
    """The list of records in a value, each a dict or a list; None without any."""
    if isinstance(value, list):
        kinds = {type(one) for one in value}
        if value and kinds in ({dict}, {list}):
            return value
        return None
    if not isinstance(value, dict) or not value:
        return None
    parts = list(value.values())
    if len(parts) > 1 and all(isinstance(one, list) and one for one in parts):
        length = len(parts[0])
        of_scalars = not any(isinstance(x, list | dict) for one in parts for x in one)
        if of_scalars and length == n_numbers < len(parts):  # a name, and its numbers
            return [{"name": key, "joint": one} for key, one in value.items()]
        shapes = {_shape(x) for one in parts for x in one}
        if not of_scalars and len(shapes) == 1:  # a label, and its rows
            return [{"position": key, "joint": x} for key, one in value.items() for x in one]
        if length > 1 and all(len(one) == length for one in parts):  # columns
            keys = list(value)
            return [dict(zip(keys, cells, strict=True)) for cells in zip(*parts, strict=True)]
    dicts = all(isinstance(one, dict) for one in parts)
    if dicts and all(str(key).isdigit() for one in parts for key in one):  # columns of pandas
        keys = list(dict.fromkeys(key for one in parts for key in one))
        return [{name: one.get(key, "") for name, one in value.items()} for key in keys]
    if dicts and len(parts) > 2 and len({tuple(one) for one in parts}) == 1:
        return [{"name": key, **one} for key, one in value.items()]
    inner = [_records(one, n_numbers) for one in parts if isinstance(one, list | dict)]
    found = max(filter(None, inner), key=len, default=None)
    # Names of the joints may stand once for all records.
    names = {key: one for key, one in value.items() if str(key).endswith(("name", "names"))}
    names = {key: one for key, one in names.items() if isinstance(one, list)}
    return [names | one for one in found] if found and isinstance(found[0], dict) else found


def _shape(value):
    """The keys of a dict, the length of a list."""
    return tuple(value) if isinstance(value, dict) else len(value) if isinstance(value, list) else 0


def _flattened(value, path=""):
    """Cells of a record by the names of its parts: q1, pose.x, position[0]."""
    if isinstance(value, dict):
        parts = [(f"{path}.{key}" if path else str(key), one) for key, one in value.items()]
    elif isinstance(value, list):
        parts = [(f"{path}[{i}]", one) for i, one in enumerate(value)]
    else:
        return {path: "" if value is None else value}
    return {name: cell for key, one in parts for name, cell in _flattened(one, key).items()}
