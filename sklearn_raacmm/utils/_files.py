"""Files that are whole or not there."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import os
from pathlib import Path


def write_whole(contents):
    """Write files beside their places and rename them when all are complete.

    What goes wrong while writing, such as a full disk, leaves files of these names as they were.

    Parameters
    ----------
    contents : dict of path-like to str or bytes
        Text is written as UTF-8 with plain line feeds, so that it is the same bytes everywhere.

    Raises
    ------
    OSError
        If a folder is missing or a file cannot be written.
    """
    for path in contents:
        if not Path(path).resolve().parent.is_dir():
            raise FileNotFoundError(f"No such folder: {Path(path).resolve().parent}.")
    places = {}
    try:
        for path, content in contents.items():
            path = Path(path).resolve()  # a link stays a link
            beside = places[path] = path.with_name(f"{path.name}.{os.getpid()}.tmp")
            beside.write_bytes(content.encode() if isinstance(content, str) else content)
        for path, beside in places.items():
            beside.replace(path)
    finally:
        for beside in places.values():
            beside.unlink(missing_ok=True)
