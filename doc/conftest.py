"""The examples of the pages are run by pytest, each page in an empty folder."""

from pathlib import Path

import pytest

collect_ignore_glob = ["*.py", "_build/*", "auto_examples/*", "generated/*"]
# Pages whose examples take five seconds or more, and the first page, which is much of README.md.
LONG = {"get_started.md", "index.md", "recipes.md", "scale.md", "metadata_routing.md"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the pages as slow, and the longest as exhaustive."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.slow)
            if item.path.name in LONG:
                item.add_marker(pytest.mark.exhaustive)


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
