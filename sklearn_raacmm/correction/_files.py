"""The folder of a correction: written whole or not at all, and read.

Files of this package's own models are read without skops. Importing skops takes longer than
everything else that a short command does. What is read here is less than skops reads: numbers,
text, arrays, lists, and the classes named by the caller. Nothing that is in the file is run, and a
file that holds anything else is left to skops.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import glob
import json
import os
import re
from collections.abc import Iterable, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.utils import (
    check_unpacked,
    digest_of,
    stored_classes,
    trusted_types,
    write_whole,
)

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_FACTS = "correction.json"
# Of the folder.
_FORMAT = 2
# The module in the name of a class of ours in a skops file, behind that of its subpackage.
_PRIVATE = re.compile(rb'(?<="__module__": )("sklearn_raacmm\.\w+)\._\w+(?=")')
# Names that `write_whole` gives to files until they are complete.
_LEFT_OVER = re.compile(r".+\.[0-9a-f]{16}\.[0-9a-f]{8}\.tmp")

# Types of the keys of dicts, by their names.
_KEYS = {"str": str, "int": int, "float": float, "bool": bool}
# Arrays, and NumPy's numbers.
_ARRAYS = {"numpy.ndarray", *(f"numpy.{kind.__name__}" for kind in np.sctypeDict.values())}


def _skops():
    """The module that reads and writes models without running code of theirs."""
    try:
        import skops.io
    except ImportError:
        raise ImportError("To save or load a model, install skops: pip install skops.") from None
    return skops.io


def dump_model(model: object) -> bytes:
    """Contents of the file of a fitted model, with the public names of our classes.

    Those of modules would change with every file that is moved.
    """
    file = BytesIO()
    with ZipFile(BytesIO(_skops().dumps(model))) as made, ZipFile(file, "w") as named:
        for entry in made.infolist():
            named.writestr(entry, _PRIVATE.sub(rb"\1", made.read(entry)))
    return file.getvalue()


def load_model(folder: str | PathLike[str], content: bytes, written_by: object) -> Any:
    """Fitted model of a skops file of this folder, which such a version has written."""
    with suppress(BadZipFile):  # which skops says
        check_unpacked(f"{folder}: the model", BytesIO(content))
    try:
        with suppress(OtherContentError):
            return read_model(content, stored_classes())
        return _skops().loads(content, trusted=trusted_types())
    except Exception as error:  # of a file of another version, anything
        raise ValueError(
            f"{folder} was written by {written_by}, whose model this version, {__version__}, "
            f"cannot read: learn again, or install the other version. ({error})"
        ) from None


def write_folder(
    folder: str | PathLike[str], facts: Mapping[str, object], contents: dict[str, str | bytes]
) -> list[Path]:
    """Write ``correction.json``, with the fingerprints of all other files, and these files.

    Whatever interrupts the writing, the folder holds the old correction or this one. Of several
    that write at the same time, the last is there, whole.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    digests = {name: digest_of(content) for name, content in contents.items()}
    facts = {**facts, "files": digests, "format": _FORMAT}
    facts["fingerprint"] = _fingerprint(facts)
    contents = {_FACTS: json.dumps(facts, indent=1, ensure_ascii=False) + "\n", **contents}
    paths = {folder / name: content for name, content in contents.items()}
    with _locked(folder):
        write_whole(paths)
    return list(paths)


def _fingerprint(facts):
    """Of all facts but itself, however they are spaced."""
    others = {name: value for name, value in facts.items() if name != "fingerprint"}
    return digest_of(json.dumps(others, sort_keys=True))


def read_folder(
    folder: str | PathLike[str], names: Iterable[str]
) -> tuple[dict[str, Any], list[bytes]]:
    """Facts of ``correction.json``, and the contents of files that were written with it."""
    folder, contents = Path(folder), []
    if not (folder / _FACTS).is_file():
        raise FileNotFoundError(f"{folder} has no {_FACTS}; learning a correction writes one.")
    if any(map(_LEFT_OVER.fullmatch, os.listdir(folder))):
        with suppress(OSError), _locked(folder):  # what may not be written is read as it is
            pass
    with _locked(folder, shared=True):
        facts = _read_facts(folder / _FACTS)
        for name in names:
            if name not in facts["files"]:
                raise FileNotFoundError(f"{folder} was written without {name}.")
            content = _whole_file(folder / name, facts["files"][name])[1]
            if content is None:
                state = "not the one" if (folder / name).exists() else "missing, the one"
                raise ValueError(
                    f"{folder}: {name} is {state} that {_FACTS} was written with: copy the whole "
                    "folder again, or learn again."
                )
            contents.append(content)
    return facts, contents


def _read_facts(path):
    """Facts that nobody has changed since they were written."""
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        version, unchanged = facts["format"], facts["fingerprint"] == _fingerprint(facts)
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{path} holds no correction: learn again.") from None
    if version == _FORMAT and unchanged:
        return facts
    if isinstance(version, int) and version > _FORMAT:
        raise ValueError(
            f"{path} has format {version}, of a newer version of sklearn_raacmm: this one reads "
            f"{_FORMAT}. Install the newer one."
        )
    raise ValueError(
        f"{path} was changed after it was written: its fingerprint is another. Copy the whole "
        "folder again, or learn again."
    )


def _whole_file(path, digest):
    """Place and content of the file of this fingerprint, by `digest_of`; None where there is none.

    It is at its place, or not yet renamed where `write_whole` did not come to its end.
    """
    for place in (path, *path.parent.glob(f"{glob.escape(path.name)}.{digest[:16]}.*.tmp")):
        if place.is_file() and digest_of(content := place.read_bytes()) == digest:
            return place, content
    return path, None


def _finish(folder):
    """Give each file of the folder's correction its name that is still beside its place."""
    with suppress(OSError, ValueError):
        for name, digest in _read_facts(folder / _FACTS)["files"].items():
            place, content = _whole_file(folder / name, digest)
            if content is not None and place != folder / name:
                place.replace(folder / name)


@contextmanager
def _locked(folder, shared=False):
    """Wait until no other process or thread writes into this folder (nor reads, unless `shared`).

    The lock goes with the process that holds it. Windows has none for folders. Who does not share
    the folder first gives the files of its correction their names, if `write_whole` was killed
    before it did, and removes at the end what else that has left there.
    """
    handle = None
    try:
        if fcntl is not None:
            handle = os.open(folder, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        if not shared:
            _finish(folder)
        yield
        if not shared:
            for path in folder.glob("*.tmp"):
                if _LEFT_OVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)
    finally:
        if handle is not None:
            os.close(handle)


class OtherContentError(ValueError):
    """A file that holds more than is read here."""


def read_model(content: bytes, kinds: dict[str, type]) -> Any:
    """Object of a skops file.

    Parameters
    ----------
    content : bytes
        The file.
    kinds : dict of str to type
        Classes by their names with the module, as they stand in the file; no others are made.

    Returns
    -------
    object
        What `skops.io.loads` returns for it.

    Raises
    ------
    OtherContentError
        If the file holds anything but plain values, arrays and these classes.
    """
    with ZipFile(BytesIO(content)) as file:
        return _read(json.loads(file.read("schema.json")), file, kinds, {})


def _read(node, file, kinds, made):
    """Object of a node of a file; one that stands there several times, as in `made`, is one."""

    def read(other):
        return _read(other, file, kinds, made)

    known, loader, name = node.get("__id__"), node["__loader__"], node["__class__"]
    whole_name = f"{node['__module__']}.{name}"
    kind = kinds.get(whole_name)
    value: Any
    if known in made:
        return made[known]
    if loader == "JsonNode":
        value = json.loads(node["content"])
    elif loader == "TypeNode" and whole_name.removeprefix("builtins.") in _KEYS:
        value = _KEYS[name]
    elif loader == "DictNode" and whole_name == "builtins.dict":
        keys = zip(read(node["key_types"]), node["content"], strict=True)
        value = {key(text): read(node["content"][text]) for key, text in keys}
    elif loader == "ListNode" and whole_name == "builtins.list":
        value = [read(one) for one in node["content"]]
    elif loader == "TupleNode" and whole_name == "builtins.tuple":
        value = tuple(read(one) for one in node["content"])
    elif loader == "TupleNode" and hasattr(kind, "_fields"):
        value = kind(*(read(one) for one in node["content"]))
    elif loader == "NdArrayNode" and node["type"] == "numpy" and whole_name in _ARRAYS:
        value = np.load(BytesIO(file.read(node["file"])), allow_pickle=False)
        value = value if name == "ndarray" else getattr(np, name)(value)
    elif loader == "ObjectNode" and kind is not None:
        value = kind.__new__(kind)
        if node.get("content") is not None:
            getattr(value, "__setstate__", vars(value).update)(read(node["content"]))
    else:
        raise OtherContentError(f"{loader} of {whole_name}")
    if known is not None:
        made[known] = value
    return value
