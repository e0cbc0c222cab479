"""Rows of files that are no table: programs of robots, echoes of messages, lists and records.

What a file is, its content says, never the ending of its name.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import ast
import csv
import io
import json
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from itertools import groupby
from typing import Any
from xml.etree import ElementTree

_VALUE = r"([+-]?\d*\.?\d+(?:[eE][+-]?\d+)?)"
_IN_LIST = rf"(?:^|,)\s*{_VALUE}"
_OF_AXIS = rf'[Aj]\d(?:\s+|="){_VALUE}'
# The name of a record, where it has one. Bounded, so that no long cell takes minutes.
_NAMED = r"(?:\b(\w{1,80})\s?=\s?)?"
# The axes of a jointtarget, and a point of a Fanuc with its number and its name.
_ROBAX = r"\[([^][]*)\]"
_FANUC_POINT = r'P\[(\d+(?:\s*:\s*"[^"]*")?)\]'
# Programs and logs of controllers: what they are, what their text holds in any case, which is found
# faster than a pattern, a record with its name and its body, and the joints in the body.
_PROGRAMS = (
    # KUKA System Software, KRL reference: structures AXIS and E6AXIS.
    ("KUKA KRL", ("{", "A1"), _NAMED + r"\{(?:E6AXIS:|AXIS:)?\s?(A1\s[^{}]*)\}", _OF_AXIS),
    # KUKA.RobotSensorInterface: element AIPos, the axes' actual positions.
    ("KUKA RSI", ("<AIPos",), r"<(AIPos)\s([^>]*)>", _OF_AXIS),
    # ABB, RAPID data types: jointtarget is [robax, extax].
    # Without a name it is told from other lists by the external axes that are not there, 9E9.
    ("ABB RAPID", ("[[", ":="), rf"\b(\w{{1,80}})\s?:=\s?\[{_ROBAX}\s?,\s?\[[^][]*\]\]", _IN_LIST),
    ("ABB RAPID", ("[[", "9E"), rf"()\[{_ROBAX}\s?,\s?\[[^][]*9[eE]\+?0?9[^][]*\]\]", _IN_LIST),
    # Fanuc: section /POS of an LS file in joint representation.
    ("Fanuc LS", ("P[", "J1"), _FANUC_POINT + r"\s*\{([^{}]*)\}", rf"J\d\s*=\s*{_VALUE}\s*deg"),
    # Doosan, programming manual: posj(J1, ..., J6).
    ("Doosan posj", ("posj",), _NAMED + r"\bposj\s?\(([^()]*)\)", _VALUE),
    # Staubli VAL3: data of the type jointRx in a .dtx file.
    ("Staubli VAL3", ("<Value",), r'<Value key="(\w{1,80})"\s([^<>]*\bj1=[^<>]*)>', _OF_AXIS),
    # Efort: a jointtarget is j:{J1, ..., J6, external axes}.
    ("Efort", (":{",), _NAMED + r"\b[jJ]:\{([^{}]*)\}", _VALUE),
    # Universal Robots, URScript manual: movej takes joint angles in rad, or a pose behind a p.
    ("URScript", ("movej",), r"()\bmovej\s*\(\s*\[([^][]*)\]", _VALUE),
    # Yaskawa, job with POSTYPE PULSE: the counts of the axes' encoders.
    ("Yaskawa JBI", ("PULSE",), r"(?m)^\s*(C\d{4,6})=([-+\d, ]+)$", _VALUE),
)
# Units of the angles of those that have others than degrees.
_UNITS = {"URScript": "rad", "Yaskawa JBI": "counts"}
# Jobs whose points are positions of the tool, not of the joints.
_CARTESIAN_JOB = re.compile(r"(?m)^///(?:POSTYPE\s+(?:BASE|ROBOT|USER|TOOL)|RECTAN)\b")
# A record of a program stands within so many characters, or the file is none; and so many lines
# are looked at for lists and pairs.
HEAD_CHARACTERS = 1 << 20
_LOOKED_AT = 300
_BRACKETS = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")
_SPLIT = re.compile(r"\s*[,;]\s*|\s+")
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_IS_NUMBER = re.compile(NUMBER)
_PAIR = re.compile(rf"\b([A-Za-z_][\w.]{{0,40}})\s*[=:]\s*{_VALUE}(?![\w.])")
_SPACED_PAIR = re.compile(rf"\b([A-Za-z_][\w.]{{0,40}})\s+{_VALUE}(?![\w.])")
# A list in a cell of a table, in quotation marks where its numbers are parted by commas.
_LIST_IN_CELL = re.compile(r"""(?m)(?:^|[,;\t])\s*"\s*[\[(]""")
# External axes that may stand behind the joints in a list, at most.
_MORE_AXES = 6
_COMMENT = re.compile(r"\s*(#|//|%|--)")
# Keys and aliases of YAML, and what it has for nothing, and for no number.
_KEY = re.compile(r"""[\s-]*("[^"]*"|'[^']*'|[^\s\[\]{},"'#:-][^\[\]{},"'#:]*):(\s|$)""")
_ALIAS = re.compile(r"(?m)(?:^|[\s\[,])\*\w+\s*[,\]\n]")
_NOTHING = ("~", "null", ".nan")
# Poses of the tool of URScript, and of MELFA, which has two brackets.
_POSE_IN_BRACKETS = re.compile(r"\bp\[|\)\s*\(")


def find_records(text, read, n_numbers):
    """What a file of text is, names of columns or None, and rows (number, cells); None of a table.

    `text` is the file's beginning, `read` a function that returns all of it. Of a file that holds
    poses of the tool where joints are needed, a ValueError says so.
    """
    for find in (_json, _program, _xml, _yaml, _cells, _lists, _pairs):
        if records := find(text, read, n_numbers):
            return records
    return None


# -- programs -------------------------------------------------------------------------------------


def _program(head, read, n_joints):
    """A program or log of a robot's controller that holds joint positions."""
    if head.lstrip().startswith("/JOB") and _CARTESIAN_JOB.search(head):
        raise ValueError("its points are poses of the tool; joint angles are needed: as PULSE.")
    for what, marks, record, value in _PROGRAMS:
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
            unit = _UNITS.get(what, "deg")
            names = ["name", *(f"A{i} [{unit}]" for i in range(1, n_joints + 1))]
            return f"{what}, {unit.replace('deg', 'degrees')}", names, rows
    return None


# -- lists in lines, and pairs of names and numbers -----------------------------------------------


def _numbers_in(text):
    """Numbers of a list, as text; None if something else is in it."""
    cells = [cell for cell in _SPLIT.split(text.strip()) if cell]
    return cells if cells and all(map(_IS_NUMBER.fullmatch, cells)) else None


def _lists(head, read, n_numbers):
    """Lists of so many numbers or a few more in brackets, perhaps with names and further lists."""
    some = [line for line in head.splitlines()[:_LOOKED_AT] if line.strip()]
    sizes = [[len(one) for _, one in lists] for _, lists in _lists_in("\n".join(some))]
    wanted = sum(len(_of_joints(one, n_numbers)) for one in sizes)
    if wanted < 2 or 3 * wanted < len(some):
        return None
    text, line, done = read(), 1, 0
    lines: list[tuple[int, str, list[str], list[list[str]]]] = []
    for begin, lists in _lists_in(text):
        sizes = [len(numbers) for _, numbers in lists]
        if not _of_joints(sizes, n_numbers):
            continue
        line, done = line + text.count("\n", done, begin), begin
        if n_numbers > 3 and _POSE_IN_BRACKETS.search(text[begin : lists[-1][0].end()]):
            raise ValueError(f"row {line} holds a pose of the tool; joint angles are needed.")
        if len(sizes) > 2 and {*sizes} == {n_numbers}:  # rows in one line
            lines += [(k, "", [""], [one]) for k, (_, one) in enumerate(lists, line)]
            continue
        ends = [begin, *(match.end() for match, _ in lists)]
        before = [text[end : match.start()] for end, (match, _) in zip(ends, lists, strict=False)]
        words = [(re.findall(r"[^\W\d]\w*", one) or [""])[-1] for one in before]
        quoted = re.search("""["']([^"']+)["']""", before[0])
        name = quoted[1] if quoted else before[0].strip(" \t=:,;([{")
        lines.append((line, name, words, [numbers for _, numbers in lists]))
    sizes = [len(one) for one in lines[0][3]]
    for line, _, _, lists in lines:
        if (own := [len(one) for one in lists]) != sizes:
            raise ValueError(f"row {line} has lists of {own} numbers, others of {sizes}.")
    own = _of_joints(sizes, n_numbers)[0]
    further = zip(*(one[3][own][n_numbers:] for one in lines), strict=True)
    if any(len({*numbers}) > 1 for numbers in further):  # they are no axes that stand still
        return None
    words = [one[2] for one in lines]
    words = [one[0] if len({*one}) == 1 else "" for one in zip(*words, strict=True)]
    header = ["name", *_names_of_lists(sizes, words, n_numbers)]
    names = {name for _, name, *_ in lines}
    begin = int(len(names) == 1 or "" in names)  # names that tell nothing apart are left out
    rows = [(n, [name, *(x for one in lists for x in one)][begin:]) for n, name, _, lists in lines]
    return "Lists in brackets", header[begin:], rows


def _lists_in(text):
    """Yield where lines begin, and their lists of two numbers or more, each with its match."""
    lists = ((match, _numbers_in(match[1])) for match in _BRACKETS.finditer(text))
    lists = ((match, numbers) for match, numbers in lists if numbers and len(numbers) > 1)
    for begin, some in groupby(lists, key=lambda one: text.rfind("\n", 0, one[0].start()) + 1):
        yield begin, list(some)


def _of_joints(sizes, n_numbers):
    """Which lists may hold the joints, or a point; external axes may follow the robot's own."""
    exact = [k for k, size in enumerate(sizes) if size == n_numbers]
    most = n_numbers + _MORE_AXES * (n_numbers > 3)
    return exact or [k for k, size in enumerate(sizes) if n_numbers < size <= most]


def _names_of_lists(sizes, words, n_numbers):
    """Names of the numbers of lists: of the joints, of a point, or the word before the list."""
    joints, names = _of_joints(sizes, n_numbers), []
    for k, (size, word) in enumerate(zip(sizes, words, strict=True)):
        if joints == [k] and n_numbers > 3:
            names += [f"joint[{i}]" for i in range(1, n_numbers + 1)]
            names += [f"E{i}" for i in range(1, size - n_numbers + 1)]
        elif size == 3 and sizes.count(3) == 1:
            names += "xyz"
        else:
            own = word if word and words.count(word) == 1 else f"list {k + 1}"
            names += [f"{own}[{i}]" for i in range(1, size + 1)]
    return names


def _cells(head, read, n_numbers):
    """A table some of whose cells hold lists."""
    if not _LIST_IN_CELL.search(head):
        return None
    separator = max(",;\t", key=head.partition("\n")[0].count)
    with suppress(csv.Error):
        lines = csv.DictReader(io.StringIO(read()), delimiter=separator, restval="")
        records = [{str(key): _parted(str(cell)) for key, cell in one.items()} for one in lines]
        return _of_records("Lists in cells", records, n_numbers)
    return None


def _parted(cell):
    """The parts of a list in a cell, and other cells as they are."""
    is_list = cell[:1] in ("[", "(", "{") and cell[-1:] in ("]", ")", "}")
    return [one.strip("\"'") for one in _SPLIT.split(cell[1:-1].strip())] if is_list else cell


def _pairs(head, read, n_numbers):
    """Lines of names with their numbers, such as X= 1.5 Y= 2 Z= 3, behind or under a name."""
    some = [line for line in head.splitlines()[:_LOOKED_AT] if line.strip()]
    # Behind blanks stand numbers of many things: they are those of names where there are no others.
    bare = [line for line in some if not re.search(r"\d", _SPACED_PAIR.sub("", line))]
    for pair, lines in ((_PAIR, some), (_SPACED_PAIR, bare)):
        keys = Counter(tuple(key for key, _ in pair.findall(line)) for line in lines)
        keys = {names: count for names, count in keys.items() if len(set(names)) >= n_numbers}
        if keys and 3 * sum(keys.values()) >= len(some):
            break
    else:
        return None
    rows, heading = [], ""
    names = list(dict.fromkeys(name for line in keys for name in line))
    for number, line in enumerate(read().splitlines(), 1):
        pairs = dict(pair.findall(line))
        is_row = len(pairs) >= n_numbers
        before = pair.split(line, maxsplit=1)[0] if is_row else line
        if before.strip() and not _COMMENT.match(before):
            heading = before.strip(" \t:;,=([{")
        if is_row:
            rows.append((number, [heading or f"row {number}", *(pairs.get(k, "") for k in names)]))
    return "Names with numbers", ["name", *names], rows


# -- records: JSON, YAML, echoes of messages ------------------------------------------------------


def _json(head, read, n_numbers):
    """Records of JSON, TOML or Python, of one document or of one in each line."""
    if head.lstrip()[:1] not in ("{", "[") and "\n[[" not in head:
        return None
    text = read()
    lines = [line for line in text.splitlines() if line.strip()]
    by_line = all(line.lstrip().startswith("{") for line in lines)
    parsers = {"JSON": json.loads, "TOML": tomllib.loads, "Python": ast.literal_eval}
    for what, parse in parsers.items():
        for parts in ([text], *[lines] * by_line):
            with suppress(ValueError, SyntaxError, TypeError, RecursionError, MemoryError):
                parsed = list(map(parse, parts))
                return _of_records(what, parsed[0] if len(parsed) == 1 else parsed, n_numbers)
    return None


def _xml(head, read, n_numbers):
    """Records of XML, each an element with attributes or simple elements; or rows of HTML."""
    if not head.lstrip().startswith("<") or "<!ENTITY" in (text := read()):
        return None
    try:
        root = ElementTree.fromstring(text.strip())
    except ElementTree.ParseError:
        return None
    if rows := [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]:
        return "HTML", None, list(enumerate(rows, 1))
    by_tag: dict[str, list[Mapping[str, object]]] = {}
    for one in root.iter():
        simple = {part.tag: part.attrib or (part.text or "").strip() for part in one}
        by_tag.setdefault(one.tag, []).append(one.attrib | simple)
    found = filter(None, (_of_records("XML", each, n_numbers) for each in by_tag.values()))
    return max(found, key=lambda one: (len(one[2]), len(one[1] or ())), default=None)


def _yaml(head, read, n_numbers):
    """Records of YAML: lists of them, or messages as `ros2 topic echo` writes them."""
    lines = [line for line in head.splitlines()[:_LOOKED_AT] if line.strip()]
    lines = [line for line in lines if not _COMMENT.match(line) or line.startswith("---")]
    begins = any(map(_KEY.match, lines[:5])) or "".join(lines[:1]).startswith("---")
    if not begins or find_spec("yaml") is None:
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
            parsed = [_cleaned(one) for one in yaml.load_all(text, Loader) if one]
            return _of_records("YAML", parsed[0] if len(parsed) == 1 else parsed, n_numbers)
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
    rows = [(i, [one.get(name, "") for name in names]) for i, one in enumerate(flat, 1)]
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
            return [dict(zip(value, cells, strict=True)) for cells in zip(*parts, strict=True)]
    dicts = all(isinstance(one, dict) for one in parts)
    if dicts and all(str(key).isdigit() for one in parts for key in one):  # columns of pandas
        keys = list(dict.fromkeys(key for one in parts for key in one))
        return [{name: one.get(key, "") for name, one in value.items()} for key in keys]
    if dicts and len(parts) > 2 and len({tuple(one) for one in parts}) == 1:
        return [{"name": key, **one} for key, one in value.items()]
    inner = [_records(one, n_numbers) for one in parts if isinstance(one, list | dict)]
    inside = max(filter(None, inner), key=len, default=None)
    # Names of the joints, or of the columns, may stand once for all records.
    names = {key: one for key, one in value.items() if isinstance(one, list)}
    if inside and isinstance(inside[0], list):
        fitting = [one for one in names.values() if len(one) == len(inside[0])]
        of_columns = next((one for one in fitting if {*map(type, one)} == {str}), None)
        return [dict(zip(of_columns, one, strict=True)) for one in inside] if of_columns else inside
    names = {key: one for key, one in names.items() if str(key).endswith(("name", "names"))}
    return [names | one for one in inside] if inside else inside


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
