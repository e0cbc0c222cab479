"""A file from the network, checked by the SHA-256 of what its authors published."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
from pathlib import Path

from sklearn.datasets import get_data_home

# The public `fetch_file` does the same, but refuses addresses of local files.
from sklearn.datasets._base import RemoteFileMetadata, _fetch_remote

# Checksum of each file, by its name.
_LINES = Path(__file__).with_name("_sha256.txt").read_text(encoding="utf-8").splitlines()
SHA256 = {name: checksum for checksum, name in map(str.split, _LINES)}


def data_folder(data_home, name):
    """Folder of a data set below scikit-learn's data folder or `data_home`."""
    if data_home is not None and Path(data_home).is_file():
        raise NotADirectoryError(f"data_home={str(data_home)!r} is a file; a folder is needed.")
    return Path(get_data_home(data_home)) / name


def cached_file(name, folder, address, *, download_if_missing, n_retries=3, delay=1.0):
    """Path of a file of `SHA256` below a folder, downloaded where it is not there or damaged."""
    path, url, sha256 = folder / name, f"{address.rstrip('/')}/{name}", SHA256[name]
    if not download_if_missing:
        if not path.is_file():
            raise OSError(f"{path} is not there, and download_if_missing=False.")
        if (found := hashlib.sha256(path.read_bytes()).hexdigest()) != sha256:
            raise OSError(
                f"{path} has the SHA-256 checksum {found}, but {sha256} is expected: it was cut "
                "short or changed, and download_if_missing=False."
            )
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        return _fetch_remote(
            RemoteFileMetadata(path.name, url, sha256), path.parent, n_retries, delay
        )
    except OSError as error:
        raise OSError(f"{url} cannot be downloaded: {error}") from error
