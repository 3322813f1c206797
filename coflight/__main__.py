"""``python -m coflight``: the ``coflight`` command."""

import sys

from coflight.command import main

sys.exit(main())
