"""The version of the package and its public place: all that need them read them here."""

import re

__version__ = "0.1.0.dev0"

# The public repository, such as "https://github.com/OWNER/sklearn_raacmm"; None while there is no
# such place. The links of the package index and those of estimators in notebooks are made of it.
REPOSITORY = None


def documentation_of(repository):
    """Address of the pages that the workflow publishes, None without a public place."""
    pages = re.sub(r"^https://github\.com/([^/]+)/", r"https://\1.github.io/", repository or "")
    return f"{pages.rstrip('/')}/" if pages else None
