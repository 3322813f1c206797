"""What crosses process borders between radios, emulator and time master."""
