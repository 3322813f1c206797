"""The 802.11 emulator against ns-3, Bianchi's model and the figures of the standard; and what it costs."""
