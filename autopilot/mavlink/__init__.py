"""MAVLink framing, signing, PX4's mode numbers and the UDP link. The services are in `autopilot.services`."""
