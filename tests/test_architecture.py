"""What the package and its subpackages hand on. Who may import what, `lint-imports` checks."""

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


def test_every_module_of_a_subpackage_is_private():
    modules = {p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*.py")}
    assert {m for m in modules if not m.split("/")[-1].startswith("_")} == set()
