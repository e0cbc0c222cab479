"""``python -m sklearn_raacmm`` is the command ``raacmm``."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import sys

from sklearn_raacmm.app import main

if __name__ == "__main__":
    sys.exit(main())
