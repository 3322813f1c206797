"""MAVLink at the edge: bytes, PX4's modes and the UDP link. The services are in `autopilot.services`."""
