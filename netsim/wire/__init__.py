"""Messages between radios, emulator and time master."""
