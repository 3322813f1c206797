"""Applications that misbehave on UAV 1 after a second, named by scenarios of tests by their paths."""

import threading

from coflight import Application


class _Bad(Application):
    def start(self, context):
        self.context = context

    def on_timer(self, now_us):
        if self.context.uav == 1 and now_us >= 1_000_000:
            self.misbehave()


class Raises(_Bad):
    def misbehave(self):
        raise RuntimeError("as written")


class Loops(_Bad):
    def misbehave(self):
        while True:
            pass


class Blocks(_Bad):
    """Blocks outside of Python, until a test of the same process sets ``released``."""

    released = threading.Event()

    def misbehave(self):
        self.released.wait()


class Allocates(_Bad):
    def misbehave(self):
        taken = []
        while True:
            taken.append(bytearray(b"x") * 4_000_000)


class Floods(_Bad):
    """Sends 10^5 datagrams per second."""

    def misbehave(self):
        for _ in range(4_000):
            self.context.radio.broadcast(bytes(100))


class FloodsWithoutBound(_Bad):
    def misbehave(self):
        while True:
            self.context.radio.broadcast(b"")


class SendsText(_Bad):
    def misbehave(self):
        self.context.autopilot.send("take off")


class ReturnsText(_Bad):
    def misbehave(self):
        pass

    def status(self):
        return "flying"
