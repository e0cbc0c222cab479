"""Files that are whole or not there."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import os
import secrets
import shutil
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import IO, TypeVar
from zipfile import ZipFile

import numpy as np

# What a zip file may unpack to: so many bytes, and so many times its own size. Tables of equal
# numbers come to 50 times, an attack to 1000. A choice.
_MOST_BYTES, _MOST_TIMES = 10_000_000, 100

Place = TypeVar("Place", bound=str | PathLike[str])


def check_places(
    outputs: Iterable[str | PathLike[str]], inputs: Iterable[str | PathLike[str]] = ()
) -> None:
    """Refuse files that could not be written, or that are read: before the work, not after it.

    Folders on the way to the outputs may still be made.
    """
    inputs = [path for path in map(Path, inputs) if path.exists()]
    seen = set()
    for path in outputs:
        place = Path(path)
        if place.exists() and any(place.samefile(source) for source in inputs):
            raise ValueError(f"{path} is read and would be written over: choose another name.")
        if place.resolve() in seen:
            raise ValueError(f"{path} would be written twice: choose two names.")
        seen.add(place.resolve())
        if place.is_dir():
            raise IsADirectoryError(f"A file is to be written, but this is a folder: {path}.")
        if place.exists() and not place.is_file():
            raise OSError(f"{path} is no ordinary file, and only such files are written.")
        if place.exists():
            try:  # Windows replaces no file that another program holds open
                place.replace(place)
            except OSError as error:
                raise PermissionError(f"Close {place}: it cannot be replaced ({error}).") from None
        folder = next(above for above in place.resolve().parents if above.exists())
        if not folder.is_dir():
            raise NotADirectoryError(f"{folder} is a file, and no folder for {place.name}.")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(f"Nothing can be written into the folder {folder}.")


def check_unpacked(name: object, file: str | PathLike[str] | IO[bytes]) -> None:
    """Refuse a zip file, open or a path, that would unpack to far more than it takes itself."""
    with ZipFile(file) as archive:
        sizes = [(entry.compress_size, entry.file_size) for entry in archive.infolist()]
    packed, unpacked = np.sum(sizes, axis=0, initial=0)
    if unpacked > _MOST_BYTES + _MOST_TIMES * packed:
        raise ValueError(
            f"{name} takes {packed / 1e6:.3g} MB and would unpack to {unpacked / 1e6:.4g} MB, more "
            "than any table or model does."
        )


def digest_of(content: str | bytes) -> str:
    """Fingerprint of a file's content, text or bytes: SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def write_whole(contents: Mapping[Place, str | bytes]) -> None:
    """Write files beside their places, and rename them when all are complete.

    What goes wrong while writing, such as a full disk, leaves files of these names as they were. If
    only a name cannot be given, the content stays beside its place, and the error says where.
    Threads and processes may write one name at the same time: whoever reads gets the whole of one
    of their files. The files are renamed in the order given. If the first holds the fingerprints
    of the others, each can be found by its fingerprint at every moment after the first is in place:
    at its place, or beside it as ``NAME.16 DIGITS OF ITS FINGERPRINT.8 DIGITS.tmp``.
    Text is written as UTF-8 with plain line feeds, so that it is the same bytes everywhere.
    """
    places = [Path(path).resolve() for path in contents]  # a link stays a link
    for place in places:
        if not place.parent.is_dir():
            raise FileNotFoundError(f"No such folder: {place.parent}.")
        if place.is_dir():
            raise IsADirectoryError(f"A file is to be written, but this is a folder: {place}.")
    complete, failed, renamed = [], {}, False
    try:
        for place, content in zip(places, contents.values(), strict=True):
            content = content.encode() if isinstance(content, str) else content
            # A name that no other thread or process takes; "x" refuses one that is there.
            token = f"{digest_of(content)[:16]}.{secrets.token_hex(4)}"
            beside = place.with_name(f"{place.name}.{token}.tmp")
            with open(beside, "xb") as file:
                complete.append(beside)
                file.write(content)
                file.flush()
                # The content goes to the disk before the name does. After a power failure the file
                # would be empty otherwise.
                os.fsync(file.fileno())
            if place.exists():
                shutil.copymode(place, beside)
        for place, beside in zip(places, complete, strict=True):
            try:
                beside.replace(place)
                renamed = True
            except OSError as error:
                failed[beside] = f"{place} cannot be replaced ({error}); its content is in {beside}"
                if place == places[0]:  # the others belong to it
                    failed |= dict.fromkeys(complete, failed[beside])
                    break
    finally:
        if not renamed:  # or else the others belong to what has its name already
            for beside in complete:
                if beside not in failed:
                    beside.unlink(missing_ok=True)
    if failed:
        raise OSError(f"{'; '.join(dict.fromkeys(failed.values()))}.")
