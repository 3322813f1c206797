"""Prints a line for each vehicle whose heartbeats arrive at UDP 14550, and its messages of each second."""

import collections
import time

from pymavlink import mavutil


def main() -> None:
    """Receive until the process is ended."""
    link = mavutil.mavlink_connection("udpin:0.0.0.0:14550")
    messages: collections.Counter[int] = collections.Counter()
    seen: set[int] = set()
    next_s = time.monotonic() + 1.0
    while True:
        message = link.recv_match(blocking=True, timeout=1.0)
        if message is not None:
            system = message.get_srcSystem()
            messages[system] += 1
            if message.get_type() == "HEARTBEAT" and system not in seen:
                seen.add(system)
                print(f"system {system} in sight", flush=True)
        if time.monotonic() >= next_s:
            print(f"messages {dict(messages)}", flush=True)
            messages.clear()
            next_s += 1.0


if __name__ == "__main__":
    main()
