"""MAVLink framing, dialect, signing, PX4's mode numbers, HIL messages and the UDP link.

Import `codec` for messages, `links.UdpLink` for a socket. The services are in `autopilot.services`.
"""
