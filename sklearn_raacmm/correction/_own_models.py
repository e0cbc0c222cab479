"""Reads the skops files of this package's own models without skops.

Importing skops takes longer than everything else that a short command does. What is read here is
less than skops reads: numbers, text, arrays, lists, and the classes named by the caller. Nothing
that is in the file is run, and a file that holds anything else is left to skops.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
from io import BytesIO
from typing import Any
from zipfile import ZipFile

import numpy as np

# Types of the keys of dicts, by their names.
_KEYS = {"str": str, "int": int, "float": float, "bool": bool}
# Arrays, and NumPy's numbers.
_ARRAYS = {"numpy.ndarray", *(f"numpy.{kind.__name__}" for kind in np.sctypeDict.values())}


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
    kind: Any = kinds.get(whole_name)
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
