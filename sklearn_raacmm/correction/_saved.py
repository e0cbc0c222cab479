"""Folders of a correction: whatever interrupts the writing, they hold the old or the new one."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Any

from sklearn_raacmm.utils import check_path, digest_of, whole_file, write_whole

_FACTS = "correction.json"


def write_correction(
    folder: str | PathLike[str], facts: dict[str, Any], contents: Mapping[str, str | bytes]
) -> list[Any]:
    """Write the files of a correction, and first of all their fingerprints.

    Parameters
    ----------
    folder : str or path-like
        Made if it does not exist.
    facts : dict
        What ``correction.json`` is to hold, fit for JSON.
    contents : dict of str to str or bytes
        Names of the other files and what they hold.

    Returns
    -------
    list of pathlib.Path
        The files, ``correction.json`` first.
    """
    folder = check_path("folder", folder)
    folder.mkdir(parents=True, exist_ok=True)
    facts = facts | {"files": {name: digest_of(content) for name, content in contents.items()}}
    contents = {_FACTS: json.dumps(facts, indent=1, ensure_ascii=False) + "\n", **contents}
    paths = {folder / name: content for name, content in contents.items()}
    write_whole(paths)
    return list(paths)


def read_correction(
    folder: str | PathLike[str], names: Iterable[str]
) -> tuple[dict[str, Any], list[Any]]:
    """Read files of a correction that belong together.

    Parameters
    ----------
    folder : str or path-like
        What `write_correction` wrote.
    names : iterable of str
        Files to read, beside ``correction.json``.

    Returns
    -------
    facts : dict
        Of ``correction.json``.
    contents : list of bytes
        Of the files.

    Raises
    ------
    ValueError
        If ``correction.json`` is not what was written, or a file is not the one it was written
        with.
    OSError
        If there is no such file.
    """
    folder = check_path("folder", folder)
    if not (folder / _FACTS).is_file():
        raise FileNotFoundError(f"{folder} has no {_FACTS}; learning a correction writes one.")
    try:
        facts = json.loads((folder / _FACTS).read_text(encoding="utf-8"))
        digests = {name: facts["files"].get(name) for name in names}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(f"{folder / _FACTS} holds no correction: learn again.") from None
    contents = []
    for name, digest in digests.items():
        if not digest:
            raise FileNotFoundError(f"{folder} was written without {name}.")
        content = whole_file(folder / name, digest)
        if content is None:
            state = "not the one" if (folder / name).exists() else "missing, the one"
            raise ValueError(
                f"{folder}: {name} is {state} that {_FACTS} was written with: copy the whole "
                "folder again, or learn again."
            )
        contents.append(content)
    return facts, contents
