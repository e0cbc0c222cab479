"""What the package and its subpackages hand on. Who may import what, `lint-imports` checks."""

import ast
import importlib
from pathlib import Path

import pytest

import sklearn_raacmm

PACKAGE = Path(sklearn_raacmm.__file__).parent
SUBPACKAGES = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


@pytest.mark.parametrize("name", ["sklearn_raacmm", *(f"sklearn_raacmm.{s}" for s in SUBPACKAGES)])
def test_public_names_are_there_once_and_without_underscore(name):
    module = importlib.import_module(name)
    assert [n for n in module.__all__ if n.startswith("_") and n != "__version__"] == []
    assert [n for n in module.__all__ if not hasattr(module, n)] == []
    assert len(module.__all__) == len(set(module.__all__))


def test_the_top_level_is_what_people_type():
    """At most 24 names. Results, which nobody makes, are documented where they are made."""
    names = {name for name in sklearn_raacmm.__all__ if name != "__version__"}
    assert len(names) <= 24
    results = ("CalibrationResult", "CorrectionCheck", "CorrectionScores", "Finding", "PosePlan")
    for name in (*results, "TableChange"):
        assert name not in names
        assert not hasattr(sklearn_raacmm, name)


def test_every_module_of_a_subpackage_is_private():
    modules = {p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*.py")}
    assert {m for m in modules if not m.split("/")[-1].startswith("_")} == set()


# Private names of scikit-learn in use, and what would break without each.
PRIVATE = {
    "sklearn.utils._param_validation": "checks of parameters, in all estimators and functions",
    "sklearn.base._fit_context": "the same, and the state of an estimator whose fit fails",
    "sklearn.utils.parallel._threadpool_controller_decorator": "one BLAS thread: equal digits",
    "sklearn.utils.validation._check_sample_weight": "weights of every fit and measure",
    "sklearn.utils.validation._check_feature_names_in": "PoseFeatures.get_feature_names_out",
    "sklearn.utils._safe_indexing": "rows of data frames: CylindricalResidualTarget, model cards",
    "sklearn.model_selection._search.BaseSearchCV": "groups that go to a search for its splitter",
    "sklearn.datasets._base._fetch_remote": "the fetchers of data",
    "sklearn.datasets._base.RemoteFileMetadata": "the fetchers of data",
}


def test_private_names_of_scikit_learn_are_known_and_there():
    """A new one is a choice to be written down, here and on the page "Maintenance"."""
    used, said = set(), (PACKAGE.parent / "doc" / "maintenance.md").read_text(encoding="utf-8")
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "sklearn":
                used |= {f"{node.module}.{alias.name}" for alias in node.names}
    used = {name for name in used if any(part.startswith("_") for part in name.split("."))}
    assert used == set(PRIVATE)
    for name in PRIVATE:
        module, _, last = name.rpartition(".")
        assert hasattr(importlib.import_module(module), last)
        assert last in said


def test_every_file_that_is_installed_names_its_licence():
    line = "# SPDX-License-Identifier: BSD-3-Clause\n"
    assert [p for p in PACKAGE.rglob("*.py") if line not in p.read_text(encoding="utf-8")] == []
