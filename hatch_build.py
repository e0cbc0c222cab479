"""What a package index shows: the README with whole addresses, and links of the project."""

import re
import runpy
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

PAPER = "https://doi.org/10.1177/1729881420925638"


def for_the_index(text, repository, version):
    """Make relative addresses whole, or do without them where there is no public place."""
    picture, link = r"!\[([^\]]*)\]\((?!\w+://)([^)]+)\)", r"\[([^\]]+)\]\((?!\w+://|#)([^)]+)\)"
    if repository is not None:
        text = re.sub(picture, rf"![\1]({repository}/raw/v{version}/\2)", text)
        return re.sub(link, rf"[\1]({repository}/blob/v{version}/\2)", text)
    # A picture goes with its caption in italics.
    text = re.sub(picture + r"\n\n(\*[^*]+\*\n\n)?", "", text)
    return re.sub(link, r"\1", text)


def project_urls(repository, documentation):
    """Links beside the description."""
    urls = {"Published method": PAPER}
    if repository is not None:
        urls |= {
            "Homepage": repository,
            "Documentation": documentation,
            "Source": repository,
            "Issues": f"{repository}/issues",
            "Changelog": f"{repository}/blob/main/CHANGELOG.md",
        }
    return urls


class CustomMetadataHook(MetadataHookInterface):
    """Hatchling's way to a field of its own."""

    def update(self, metadata):
        """Set the description and the links; their one setting is REPOSITORY in _version.py."""
        own = runpy.run_path(str(Path(self.root, "sklearn_raacmm", "_version.py")))
        repository = own["REPOSITORY"]
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": for_the_index(text, repository, own["__version__"]),
        }
        metadata["urls"] = project_urls(repository, own["documentation_of"](repository))
