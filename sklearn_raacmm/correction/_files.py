"""The folder of a correction: written whole or not at all, and read."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import joblib

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model import ArmResidualRegressor, Fading, Judgement, LinearModel, Terms
from sklearn_raacmm.network import Network, RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import Finding, digest_of, whole_file, write_whole

_FACTS = "correction.json"
#: What a skops file of any model made of this package's and scikit-learn's estimators needs trust
#: in: ``skops.io.load(path, trusted=TRUSTED_TYPES)``. Names of this package's own, nothing else.
TRUSTED_TYPES = [
    f"{kind.__module__}.{kind.__qualname__}"
    for kind in (
        Arm,
        Arm.azimuth,
        ArmResidualRegressor,
        CylindricalResidualTarget,
        Fading,
        Finding,
        Judgement,
        LinearModel,
        Network,
        PoseFeatures,
        RBFNetRegressor,
        Terms,
    )
]


def dump_model(model: Any) -> tuple[str, bytes]:
    """Name and contents of the file of a fitted model; without skops a joblib file."""
    try:
        import skops.io
    except ImportError:
        file = BytesIO()
        joblib.dump(model, file)
        return "model.joblib", file.getvalue()
    return "model.skops", skops.io.dumps(model)


def load_model(folder: Any, content: bytes) -> Any:
    """Fitted model of a skops file of this folder."""
    try:
        import skops.io
    except ImportError:
        raise ImportError("To load a model, install skops: pip install skops.") from None
    try:
        return skops.io.loads(content, trusted=TRUSTED_TYPES)
    except Exception as error:  # of a file of another version, anything
        raise ValueError(f"{folder} cannot be loaded: {error}") from None


def write_folder(folder: Any, facts: dict[str, Any], contents: dict[str, Any]) -> Any:
    """Write ``correction.json``, with the fingerprints of all other files, and these files.

    Whatever interrupts the writing, the folder holds the old correction or this one.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    facts = facts | {"files": {name: digest_of(content) for name, content in contents.items()}}
    contents = {_FACTS: json.dumps(facts, indent=1, ensure_ascii=False) + "\n", **contents}
    paths = {folder / name: content for name, content in contents.items()}
    write_whole(paths)
    return list(paths)


def read_folder(folder: Any, names: Any) -> tuple[dict[str, Any], list[bytes]]:
    """Facts of ``correction.json``, and the contents of files that were written with it."""
    folder = Path(folder)
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
