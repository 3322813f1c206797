"""How right the antenna is: ``python scripts/validate_antenna.py``. See `studies.antenna`."""

import os

from foundation.kernels import cache_folder

os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from studies.antenna.cli import validate_antenna_app

if __name__ == "__main__":
    validate_antenna_app()
