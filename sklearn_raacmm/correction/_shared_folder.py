"""A folder that several processes write and read: its lock, and files known by their content."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import glob
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sklearn_raacmm.utils import digest_of

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Names that `write_whole` gives to files until they are complete.
_LEFT_OVER = re.compile(r".+\.[0-9a-f]{16}\.[0-9a-f]{8}\.tmp")


def whole_file(path: Any, digest: str) -> bytes | None:
    """Content of the file of this fingerprint, by `digest_of`; None where there is none.

    It is at its place, or not yet renamed where `write_whole` did not come to its end.
    """
    path = Path(path)
    for place in (path, *path.parent.glob(f"{glob.escape(path.name)}.{digest[:16]}.*.tmp")):
        if place.is_file() and digest_of(content := place.read_bytes()) == digest:
            return content
    return None


@contextmanager
def locked(folder: Any, shared: bool = False) -> Iterator[None]:
    """Wait until no other process or thread writes into this folder (nor reads, unless `shared`).

    The lock goes with the process that holds it. Windows has none for folders. Who does not share
    the folder also removes what `write_whole` has left there when it was killed.
    """
    handle = None
    try:
        if fcntl is not None:
            handle = os.open(folder, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        yield
        if not shared:
            for path in Path(folder).glob("*.tmp"):
                if _LEFT_OVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)
    finally:
        if handle is not None:
            os.close(handle)
