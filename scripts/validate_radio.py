"""How right the emulated radio is: ``python scripts/validate_radio.py``. See `studies.radio`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.radio.cli import validate_radio_app

if __name__ == "__main__":
    validate_radio_app()
