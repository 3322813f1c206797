"""The emulated 802.11 channel: medium, channel access, Fine Time Measurement, and the clients' way to it."""
