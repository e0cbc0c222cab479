"""The arm as JSON: its text, and the fields of `Arm` in it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.arm._kinematics import Chain

_FORMAT = "sklearn_raacmm.Arm"
_FORMAT_VERSION = 1
_UNITS = {"a": "_mm", "alpha": "_rad", "d": "_mm", "theta_offset": "_rad", "probe": "_mm"}
_NEEDED = ("name", "convention", *_UNITS, "joint_signs", "pose_joints", "pose_frames")
# Field of the class -> key of the JSON file; the units are part of the file's keys.
_JSON_KEYS = {field: field + _UNITS.get(field, "") for field in _NEEDED}
# These may be missing, by their keys; limits are in rad and mm where joints slide.
_OPTIONAL = {field: field for field in ("up", "couplings", "joint_types", "up_frame")}
_OPTIONAL |= {"joint_names": "names", "limits_rad": "limits", "limits_rad_mm": "limits"}


def read_fields(source: object) -> tuple[dict[str, Any], str]:
    """Fields of `Arm` in a JSON file, and a name of the source: see `Arm.from_json`."""
    content, where = _content(source)
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ValueError(f'{where} is not an arm: it needs "format": "{_FORMAT}".')
    if content.get("format_version") != _FORMAT_VERSION:
        raise ValueError(
            f"{where} has format_version {content.get('format_version')!r}, "
            f"this version reads {_FORMAT_VERSION}."
        )
    missing = [key for key in _JSON_KEYS.values() if key not in content]
    if missing:
        raise ValueError(f"{where} lacks the field {missing[0]!r}.")
    keys = _JSON_KEYS | {field: key for key, field in _OPTIONAL.items() if key in content}
    unknown = sorted(set(content) - {*keys.values(), "format", "format_version"})
    if unknown:  # misspelt, or of a later version: it would be ignored silently
        raise ValueError(f"{where} has the unknown field {unknown[0]!r:.60}.")
    for key in keys.values():  # true and false would pass for 1 and 0
        if any(isinstance(v, bool) for v in np.ravel(np.array(content[key], dtype=object))):
            raise ValueError(f"{where}: {key} must hold numbers, got {content[key]!r:.60}.")
    return {field: content[key] for field, key in keys.items()}, where


def json_text(arm: Chain) -> str:
    """Text of an arm as JSON, with the units in the names of the fields."""
    content = {"format": _FORMAT, "format_version": _FORMAT_VERSION}
    for field, key in _JSON_KEYS.items():
        value = getattr(arm, field)
        content[key] = value.tolist() if isinstance(value, np.ndarray) else value
    slides, limits = "P" in arm.joint_types, None
    if arm.limits is not None:  # JSON has no infinity
        limits = np.where(np.isfinite(arm.limits), arm.limits, np.array(None)).tolist()
    # What is as usual is left out: such files are read by earlier versions, too.
    optional = {
        "joint_names": list(arm.names),
        "limits_rad_mm" if slides else "limits_rad": limits,
        "up": arm.up.tolist() if arm.up.tolist() != [0, 0, 1] else None,
        "couplings": [list(one) for one in arm.couplings],
        "joint_types": arm.joint_types if slides else None,
        "up_frame": arm.up_frame,
    }
    content |= {key: value for key, value in optional.items() if value}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _content(source):
    """What the JSON holds, and a name of the source for error messages."""
    if isinstance(source, dict):
        return source, "the dict"
    if not isinstance(source, str | bytes | PathLike):
        raise TypeError(
            "an arm is read from the path of a JSON file, from JSON text or bytes, or from a "
            f"dict, got {type(source).__name__}."
        )
    is_text = isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("{")
    where = "the JSON text" if is_text or isinstance(source, bytes) else str(source)
    if not is_text and not isinstance(source, bytes):
        if Path(source).is_dir():
            raise IsADirectoryError(f"{where} is a folder; the JSON file in it is needed.")
        source = Path(source).read_bytes()
    raw: Any = source
    try:
        text = raw if is_text else raw.decode("utf-8")
        # A byte-order mark, which editors on Windows write, is no part of JSON.
        return json.loads(text.removeprefix("\ufeff")), where
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, or nested without end
        raise ValueError(f"{where} is not valid JSON: {error}.") from None
