"""Program that stands in for a PX4 in flights whose processes fail: ``python px4_stand_in.py SYSTEM PORT``.

It answers each HIL_SENSOR with motors at rest, over PX4's simulator interface, and does not end by itself.
It says nothing about a PX4: docs/how-to/px4.md states how to fly one.
"""

import contextlib
import socket
import sys
import time

from pymavlink.dialects.v20 import common

RETRY_S = 0.05
LOCKSTEP = 1
MOTORS = 16


def main(system: int, port: int) -> None:
    """Connect, answer until the simulator closes the connection, and stay as a PX4 does."""
    wire = common.MAVLink(None, srcSystem=system, srcComponent=1)
    wire.robust_parsing = True
    while True:
        try:
            connection = socket.create_connection(("127.0.0.1", port))
            break
        except ConnectionRefusedError:
            time.sleep(RETRY_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    heartbeat = common.MAVLink_heartbeat_message(0, common.MAV_AUTOPILOT_PX4, 0, 0, 0, 3)
    connection.sendall(heartbeat.pack(wire))
    sys.stdout.write(f"px4 of system {system} started\n")
    sys.stdout.flush()
    with contextlib.suppress(OSError):
        while data := connection.recv(65_536):
            for message in wire.parse_buffer(data) or []:
                if message.get_type() == "HIL_SENSOR" and message.id == 0:
                    controls = common.MAVLink_hil_actuator_controls_message(
                        message.time_usec, [0.0] * MOTORS, common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, LOCKSTEP
                    )
                    connection.sendall(controls.pack(wire))
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
