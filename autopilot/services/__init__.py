"""MAVLink services without I/O, each with the interface `service.MavlinkService`; one instance per vehicle.

Import `service.Services`, which composes them; `actions_*` are commands, `telemetry_*` and `streams` what is
sent by itself. Bytes and links are in `autopilot.mavlink`.
"""
