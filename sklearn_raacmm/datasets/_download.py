"""A file from the network, checked by the SHA-256 of what its authors published."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
from pathlib import Path

from sklearn.datasets import get_data_home

# The public `fetch_file` does the same, but refuses addresses of local files.
from sklearn.datasets._base import RemoteFileMetadata, _fetch_remote

_LINES = """
9ac0f8ab838a253443f4fbb4314103c99eec11702ab16f3202b276e542d6893c panda_2/back_left/hole_0.csv
e0a264882c05e8efaba07fbac9a93ddda4622791ffd0d9d9b301f381cb823cb1 panda_2/back_left/hole_1.csv
4593fe8a60fb705d4a22af7b8dc39eed00d0858dad13cea8dc5a49eba8a3aa73 panda_2/back_right/hole_0.csv
4655bac5d6b89fab41dc32cfb08ab1f0b2815ecbc2668ac0b9cabc4c005dd7da panda_2/back_right/hole_1.csv
c7aad08357e7e76758291125a6c80eb1953022148b51c9273b4ace3e17f0c8a5 panda_2/front_center/hole_0.csv
f434cb7bb742557837ff6dd1fb8f36c8b3d973437a9f7241803a0e56522c1ab1 panda_2/front_center/hole_1.csv
5dbe7e202a5cca38828640d0151966fe71a3d4ece3fb6fadc0eda20d7a80ec25 panda_2/front_left/hole_0.csv
b9fc61e1ec7c73278bb4dd5639165b49067c13d01c5b95cbee9c3d8c4f2e055e panda_2/front_left/hole_1.csv
40a21cdb6eaa6f25195750df54da5d14d0bbcb975c2fca90f84055443f1cd085 panda_2/front_right/hole_0.csv
2518407643da102903646c85d689c09129fd2a45cc77f4a02e8ed95c2535eb2f panda_2/front_right/hole_1.csv
d7f584e50e9c001566bbfe2fbf25a5d4204b9736a1a52807fdc50bac2e219bdb panda_2/high/hole_0.csv
e55baaabfc8a4e1c28187d3ccc4e18e8cad83d809970dde4fe68b10f9e6feea6 panda_2/high/hole_1.csv
efe6e9be622f31d86faa466d1763bcb137fb56813621268c775cb9a0b9839127 panda_2/mid-high/hole_0.csv
0b631c351ba880ac702e3868d12f7778ce31561e27a5feec1cb4d3e0908a78bc panda_2/mid-high/hole_1.csv
ad200ee139563340c387604f0e25f9e275222e73d7c04713dc71d9dbd29789bf panda_2/mid_left/hole_0.csv
7edfb3ac549576331162e285ddc67c1b474179c400daf3bee5a605a422efa980 panda_2/mid_left/hole_1.csv
e3538b8cd94fa13783797f9a01e9832fb821ba4f7cc1b9703905c1f8d5fcbbe2 panda_2/mid_right/hole_0.csv
daf4b7f9c557166720cc54b86a539e2786702d84cc0b768659d810d32d197daa panda_2/mid_right/hole_1.csv
be47cb91a497f4e13b443e68d74db9f6dc799ca1321c506b1b971cd987039841 panda_3/backcenter/hole_0.csv
85c936cfc57d1af91239f7bc5e294993f01ea2e170168f28521e17940f54e699 panda_3/backcenter/hole_1.csv
afb1d1b4d279e0cf6995996abe5833e02e61a3f92621cb38bdbc477ac49b111f panda_3/backleft/hole_0.csv
84ba3cc75acae01c23f53bd965d0e048bc04d58f2271c4afd1de3118b95e2e2a panda_3/backleft/hole_1.csv
2f663c9a8523234f4011bb06ca123e1ff0e50a1478e2fcc876f40943005cdb70 panda_3/backright/hole_0.csv
933268a33c8f8dbe45e7755d32fbdb0dc9276ffa1a7d3c67e3e0a26f67b1111b panda_3/backright/hole_1.csv
ca2a7d595fb90a6e9e112b7b78bc849b32691a1f764fe9623e762f060af5ceab panda_3/frontcenter/hole_0.csv
cc7a53830159e4f7f058d04bfb33b64aa758f522757b01f3f6a09c57727033eb panda_3/frontcenter/hole_1.csv
2ff9f7f9cb03c76ba13735f6ba5083126c7dfd332cdf447f883e1f930b8a7a3c panda_3/frontleft/hole_0.csv
d7b9e45c036de5f6d574bb8f439ce1e24894adb88e9d41e3a948ab278e7cd49d panda_3/frontleft/hole_1.csv
4238c42b5bf33514241e3b7bb21e18cb3c9b01b8e35ef857898b1660e5ee349e panda_3/frontright/hole_0.csv
c8e6f3586d2b10b53373c473d59c5de818794f8a8fab579b37231a9703e5caae panda_3/frontright/hole_1.csv
84d5c81234cab58ebe88b4c73c582c26ad0e407f0de5350571c91f5ce6f28b76 measurements_grid.csv
"""
# Checksum of each file, by its name.
SHA256 = {line.split()[1]: line.split()[0] for line in _LINES.strip().splitlines()}


def data_folder(data_home, name):
    """Folder of a data set below scikit-learn's data folder or `data_home`."""
    if data_home is not None and Path(data_home).is_file():
        raise NotADirectoryError(f"data_home={str(data_home)!r} is a file; a folder is needed.")
    return Path(get_data_home(data_home)) / name


def cached_file(name, folder, address, *, download_if_missing, n_retries, delay):
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
