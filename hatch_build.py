"""What a package index shows: the README without relative addresses, and links of the project."""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

# Where the files of this version can be seen, such as "https://.../v0.1.0/", once there is a public
# place. As long as there is none, pictures are left out and links to files are plain text.
ADDRESS = None

PAPER = "https://doi.org/10.1177/1729881420925638"
# Link on the index: file of the project.
FILES = {
    "Documentation": "doc/index.md",
    "Changelog": "CHANGELOG.md",
    "Contributing": "CONTRIBUTING.md",
}


def for_the_index(text, address):
    """Make relative addresses absolute, or do without them."""
    picture, link = r"!\[([^\]]*)\]\((?!\w+://)([^)]+)\)", r"\[([^\]]+)\]\((?!\w+://|#)([^)]+)\)"
    if address is not None:
        return re.sub(link, rf"[\1]({address}\2)", text)
    # A picture goes with its caption in italics.
    text = re.sub(picture + r"\n\n(\*[^*]+\*\n\n)?", "", text)
    return re.sub(link, r"\1", text)


def project_urls(address):
    """Links beside the description; those to files only where the files can be seen."""
    urls = {"Published method": PAPER}
    if address is not None:
        urls |= {"Source": address} | {name: address + file for name, file in FILES.items()}
    return urls


class CustomMetadataHook(MetadataHookInterface):
    """Hatchling's way to a field of its own."""

    def update(self, metadata):
        """Set the description and the links."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": for_the_index(text, ADDRESS),
        }
        metadata["urls"] = project_urls(ADDRESS)
