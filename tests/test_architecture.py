"""What the package and its subpackages hand on. Who may import what, `lint-imports` checks."""

import ast
import importlib
import re
from pathlib import Path

import sklearn_raacmm

PACKAGE = Path(sklearn_raacmm.__file__).parent


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


def test_private_names_of_scikit_learn_are_known_and_there():
    """A new one is a choice to be written down on the page "Maintenance"."""
    page = (PACKAGE.parent / "doc" / "maintenance.md").read_text(encoding="utf-8")
    table = page[page.index("## Private names") : page.index("## Who maintains")]
    cells = re.sub(r"\(.*?\)", "", " ".join(re.findall(r"^\|(.*?)\|", table, flags=re.MULTILINE)))
    said = {name.split(".")[-1] for name in re.findall(r"`([\w.]+)`", cells)}
    used = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "sklearn":
                used |= {(node.module, alias.name) for alias in node.names}
    used = {(module, name) for module, name in used if "._" in f"{module}.{name}"}
    assert all(hasattr(importlib.import_module(module), name) for module, name in used)
    assert {name for _, name in used} == said


def test_every_file_that_is_installed_names_its_licence():
    line = "# SPDX-License-Identifier: BSD-3-Clause\n"
    assert [p for p in PACKAGE.rglob("*.py") if line not in p.read_text(encoding="utf-8")] == []
