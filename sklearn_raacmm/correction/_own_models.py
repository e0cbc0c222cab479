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
        return _Reader(file, kinds).read(json.loads(file.read("schema.json")))


class _Reader:
    """Objects of the nodes of one file; one that stands there several times is made once."""

    def __init__(self, file, kinds):
        self.file, self.kinds, self.made = file, kinds, {}

    def read(self, node):
        known = node.get("__id__")
        if known is not None and known in self.made:
            return self.made[known]
        make = getattr(self, f"_{node['__loader__']}", None)
        if make is None:
            raise OtherContentError(node["__loader__"])
        made = make(node, f"{node['__module__']}.{node['__class__']}")
        if known is not None:
            self.made[known] = made
        return made

    def _JsonNode(self, node, _):  # noqa: N802 - the names are those in the file
        return json.loads(node["content"])

    def _TypeNode(self, node, name):  # noqa: N802
        if name.removeprefix("builtins.") not in _KEYS:
            raise OtherContentError(name)
        return _KEYS[node["__class__"]]

    def _DictNode(self, node, name):  # noqa: N802
        if name != "builtins.dict":
            raise OtherContentError(name)
        kinds = self.read(node["key_types"])
        pairs = zip(kinds, node["content"].items(), strict=True)
        return {kind(key): self.read(value) for kind, (key, value) in pairs}

    def _ListNode(self, node, name):  # noqa: N802
        if name != "builtins.list":
            raise OtherContentError(name)
        return [self.read(one) for one in node["content"]]

    def _TupleNode(self, node, name):  # noqa: N802
        content = tuple(self.read(one) for one in node["content"])
        if name == "builtins.tuple":
            return content
        kind = self._kind(name)
        if not (issubclass(kind, tuple) and hasattr(kind, "_fields")):
            raise OtherContentError(name)
        return kind(*content)

    def _NdArrayNode(self, node, name):  # noqa: N802
        if node["type"] != "numpy":
            raise OtherContentError(node["type"])
        values = np.load(BytesIO(self.file.read(node["file"])), allow_pickle=False)
        if name == "numpy.ndarray":
            return values
        kind = getattr(np, node["__class__"], None)
        if node["__module__"] != "numpy" or not (
            isinstance(kind, type) and issubclass(kind, np.generic)
        ):
            raise OtherContentError(name)
        return kind(values)

    def _ObjectNode(self, node, name):  # noqa: N802
        kind: Any = self._kind(name)
        made = kind.__new__(kind)
        state = None if node.get("content") is None else self.read(node["content"])
        if state is not None and hasattr(made, "__setstate__"):
            made.__setstate__(state)
        elif state is not None:
            made.__dict__.update(state)
        return made

    def _kind(self, name):
        if name not in self.kinds:
            raise OtherContentError(name)
        return self.kinds[name]
