"""Broadcasts a numbered UDP datagram ten times per second and prints a line for each one that arrives.

It uses sockets alone: computers in one Ethernet segment can run it as well.
"""

import argparse
import select
import socket
import time

PORT = 5005
PERIOD_S = 0.1


def main() -> None:
    """Send and receive until the process is ended."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--id", type=int, required=True, help="number in the datagrams")
    parser.add_argument("--bytes", type=int, default=500, help="length of a datagram")
    parser.add_argument("--wait-s", type=float, default=0.0, help="time before the first datagram")
    arguments = parser.parse_args()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        link.bind(("", PORT))
        sent, next_s = 0, time.monotonic() + arguments.wait_s
        while True:
            wait_s = next_s - time.monotonic()
            if wait_s <= 0.0:
                datagram = f"{arguments.id} {sent} ".encode().ljust(arguments.bytes, b".")
                link.sendto(datagram, ("255.255.255.255", PORT))
                print(f"sent {sent}", flush=True)
                sent, next_s = sent + 1, next_s + PERIOD_S
            elif select.select([link], [], [], wait_s)[0]:
                source, number, _ = link.recv(2048).split(b" ")
                if int(source) != arguments.id:
                    print(f"received {int(source)} {int(number)}", flush=True)


if __name__ == "__main__":
    main()
