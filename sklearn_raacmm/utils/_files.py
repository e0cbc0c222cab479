"""Files that are whole or not there."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sklearn_raacmm.utils._checks import show


def check_path(name: str, value: object) -> Path:
    """Refuse what is no path of a file or folder, and give it as a `Path`."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"{name} must be the path of a file or folder, got {show(value)}.")
    return Path(value)


def write_whole(contents: Mapping[Any, str | bytes]) -> None:
    """Write files beside their places, and rename them when all are complete.

    What goes wrong while writing, such as a full disk, leaves files of these names as they were.
    Threads and processes may write one name at the same time: whoever reads gets the whole of one
    of their files.

    Parameters
    ----------
    contents : dict of path-like to str or bytes
        Text is written as UTF-8 with plain line feeds, so that it is the same bytes everywhere.

    Raises
    ------
    OSError
        If a folder is missing, a path is a folder, or a file cannot be written.
    """
    places = [check_path("path", path).resolve() for path in contents]  # a link stays a link
    for place in places:
        if not place.parent.is_dir():
            raise FileNotFoundError(f"No such folder: {place.parent}.")
        if place.is_dir():
            raise IsADirectoryError(f"A file is to be written, but this is a folder: {place}.")
    complete = []
    try:
        for place, content in zip(places, contents.values(), strict=True):
            # A name that no other thread or process takes; "x" refuses one that is there.
            beside = place.with_name(f"{place.name}.{secrets.token_hex(8)}.tmp")
            with open(beside, "xb") as file:
                complete.append(beside)
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                # The content goes to the disk before the name does. After a power failure the file
                # would be empty otherwise.
                os.fsync(file.fileno())
            if place.exists():
                shutil.copymode(place, beside)
        for place, beside in zip(places, complete, strict=True):
            beside.replace(place)
    finally:
        for beside in complete:
            beside.unlink(missing_ok=True)
