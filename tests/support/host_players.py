"""A vehicle's host that receives a recorded stream of the simulator."""

from autopilot.vehicle.host import Host

NO_LINKS = (False, False)
"""No ground station and no companion sends"""


class Player:
    """A host and its replies; ``compiled``: fast steps are allowed."""

    def __init__(self, config, *, compiled=True):
        self.host = Host(config, None)
        self.inertial = 0
        if not compiled:
            self.host._inertial.open = lambda *_, **__: None

    def play(self, data):
        host = self.host
        size = host.put(data)
        answer = host.inertial_step(size)
        if answer is not None:
            self.inertial += 1
            return bytes(answer)
        return b"".join(
            host.step(messages, link_messages=[], link_active=NO_LINKS)[0] for messages in host.push(size)
        )
