"""Prints the routes to other vehicles whenever they change; runs on a vehicle, without coflight.

Each line has the monotonic wall time in seconds and, as JSON, the next vehicle to each destination:
``12.345 {"3": 1}``: packets to vehicle 3 go to vehicle 1.
"""

import json
import time

PERIOD_S = 0.05
HOST_MASK = "FFFFFFFF"
REJECT = 0x0200
"""Flag of a route that says that there is none; babeld keeps one for some time."""


def station(address: str) -> int:
    """Return the vehicle of an address of /proc/net/route, which is 10.1.HH.LL in the host's byte order."""
    return int.from_bytes(bytes.fromhex(address)[:2][::-1], "big")


def routes(text: str) -> dict[int, int]:
    """Return the next vehicle of each host route in /proc/net/route."""
    found = {}
    for line in text.splitlines()[1:]:
        _, destination, gateway, flags, *others = line.split()
        if int(flags, 16) & REJECT:
            continue
        if others[3] == HOST_MASK and destination.endswith("010A"):
            direct = gateway == "00000000"
            found[station(destination)] = station(destination if direct else gateway)
    return found


def main() -> None:
    """Watch until the process is ended."""
    last = None
    while True:
        with open("/proc/net/route", encoding="ascii") as file:  # noqa: PTH123  no imports beyond the need
            now = routes(file.read())
        if now != last:
            last = now
            print(f"{time.monotonic():.3f} {json.dumps(now)}", flush=True)  # noqa: T201  its output
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
