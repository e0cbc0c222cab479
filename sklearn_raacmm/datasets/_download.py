"""A file from the network, checked before it takes its place."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import os
import time
from http.client import HTTPException, IncompleteRead
from pathlib import Path
from tempfile import NamedTemporaryFile
from urllib.error import HTTPError
from urllib.request import urlopen

from sklearn.datasets import get_data_home

from sklearn_raacmm.utils import warn_user

# Longest silence of a server that is waited for, and the longest time for one file with all its
# retries: ten minutes carry the largest file (2.4 MB) over a line of 32 kbit/s.
_TIMEOUT_S, _TOTAL_S = 30, 600
# Eighty times the largest file: what is larger is another file, and is not read into memory.
_MAX_BYTES = 200 * 2**20
_BLOCK_BYTES = 2**16


class _LimitError(Exception):
    """A download that is too large or takes too long; asking again would not help."""


def data_folder(data_home, *parts):
    """Folder of a data set below scikit-learn's data folder or `data_home`."""
    if data_home is not None and Path(data_home).is_file():
        raise NotADirectoryError(f"data_home={str(data_home)!r} is a file; a folder is needed.")
    return Path(get_data_home(data_home)).joinpath(*parts)


def cached_file(path, url, sha256, *, download_if_missing=True, n_retries=3, delay=1.0):
    """Path of a file that has this checksum, downloaded where it is not there yet.

    Raises
    ------
    OSError
        If the file is not there and may not or cannot be downloaded, or what was downloaded has
        another checksum, is too large or takes too long. A file that is there stays as it is then.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, but a file of this name is needed.")
    found = _sha256(path.read_bytes()) if path.is_file() else None
    if found == sha256:
        return path
    wrong = f"{path} has the SHA-256 checksum {found}, but {sha256} is expected"
    if not download_if_missing:
        if found is not None:
            raise OSError(f"{wrong}: it was cut short or changed, and download_if_missing=False.")
        raise OSError(f"{path} is not there, and download_if_missing=False.")
    if found is not None:
        warn_user(f"{wrong}: downloading it again from {url}.")
    content = _download(url, n_retries, delay)
    found = _sha256(content)
    if found != sha256:
        raise OSError(
            f"What {url} sent ({len(content)} bytes) has the SHA-256 checksum {found}, but "
            f"{sha256} is expected: it was cut short or changed. Nothing was saved."
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    # Beside its place and renamed, so that a file of this name is always whole, whoever else
    # downloads it at the same time.
    with NamedTemporaryFile(dir=path.parent, prefix=path.name, suffix=".part", delete=False) as f:
        beside = Path(f.name)
        try:
            f.write(content)
            f.close()
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)
    return path


def _sha256(content):
    return hashlib.sha256(content).hexdigest()


def _read(response, deadline):
    """Content of a response, read in blocks so that a limit ends it early."""
    size = int(response.headers.get("Content-Length", -1))
    content = bytearray()
    while True:
        if max(size, len(content)) > _MAX_BYTES:
            raise _LimitError(
                f"it has {max(size, len(content))} bytes or more, above the limit of {_MAX_BYTES}"
            )
        if time.monotonic() > deadline:
            raise _LimitError(f"{len(content)} bytes came within the limit of {_TOTAL_S} s")
        block = response.read1(_BLOCK_BYTES)  # what is there: read() would wait for a whole block
        content += block
        if not block:
            break
    if len(content) < size:
        raise IncompleteRead(bytes(content), size - len(content))
    return bytes(content)


def _download(url, n_retries, delay) -> bytes:
    deadline, left = time.monotonic() + _TOTAL_S, n_retries
    while True:
        try:
            with urlopen(url, timeout=_TIMEOUT_S) as response:
                return _read(response, deadline)
        except _LimitError as error:
            raise OSError(f"{url} cannot be downloaded: {error}.") from error
        except (OSError, HTTPException) as error:
            # Asking again does not change "not found"; a server in trouble may recover.
            final = isinstance(error, HTTPError) and error.code < 500 and error.code != 429
            if final or not left:
                raise OSError(f"{url} cannot be downloaded: {error}.") from error
            warn_user(f"{url}: {error}; trying again.")
            time.sleep(delay)
            left -= 1
