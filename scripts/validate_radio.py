"""How right the emulated radio is: ``python scripts/validate_radio.py``. See `harness.validation.radio`."""

from harness.validation.radio.cli import validate_radio_app

if __name__ == "__main__":
    validate_radio_app()
