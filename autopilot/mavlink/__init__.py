"""MAVLink framing, dialect, signing, PX4's mode numbers, HIL messages and the links.

Import `codec` for messages, `udp_link.UdpLink` or `links.MavlinkLink` for a link. The services are in
`autopilot.services`.
"""
