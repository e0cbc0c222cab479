"""The version of the package and its public place: all that need them read them here."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re

__version__ = "0.1.0.dev0"

# The public repository, such as "https://github.com/OWNER/sklearn_raacmm", which the workflow of a
# release sets; None while there is none. The links of the package index, of the pages and of
# estimators in notebooks are made of it.
REPOSITORY = None


def documentation_of(repository):
    """Address of the pages that the workflow publishes, None without a public place."""
    pages = re.sub(r"^https://github\.com/([^/]+)/", r"https://\1.github.io/", repository or "")
    return f"{pages.rstrip('/')}/" if pages else None
