"""The radio alone, without a flight: simulations of one link and measurements of the emulator."""
