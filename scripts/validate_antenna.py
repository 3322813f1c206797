"""How right the antenna is: ``python scripts/validate_antenna.py``. See `harness.validation.antenna`."""

import os

from foundation.kernels import cache_folder

os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from harness.validation.antenna.cli import validate_antenna_app

if __name__ == "__main__":
    validate_antenna_app()
