"""Validation of the 802.11 emulator against ns-3, Bianchi's model and the standard; and its benchmark."""
