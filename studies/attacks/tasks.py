"""What a program that attacks is to do, and what it reports; passed as JSON (`attack_program`)."""

from msgspec import Struct

Address = tuple[str, int]


class RandomBytes(Struct, frozen=True, kw_only=True, tag=True):
    """Send random bytes to ports and sockets."""

    datagrams_to: list[Address]
    streams_to: list[Address]
    sockets: list[str]
    """Paths of Unix sockets"""
    total_bytes: int
    small_datagrams: int
    seed: int


class MutatedMavlink(Struct, frozen=True, kw_only=True, tag=True):
    """Send mutated messages of all kinds to the MAVLink ports."""

    datagrams_to: list[Address]
    systems: list[int]
    """MAVLink systems, one for each two ports in turn"""
    rounds: int
    frames_s: float
    """Frames per second of wall time to each port"""
    seed: int


class Login(Struct, frozen=True, kw_only=True):
    """Endpoint of a radio with a user's password."""

    endpoint: str
    run_id: str
    user: str
    password: str


class ForgedBatches(Struct, frozen=True, kw_only=True, tag=True):
    """Send batches as other stations, and to them, with the password of one guest."""

    login: Login
    stations: int
    """Stations of the channel, the guest's among them"""
    station: int
    """The guest's"""
    count: int


class RefusedLogins(Struct, frozen=True, kw_only=True, tag=True):
    """Try to connect to a radio with wrong passwords."""

    logins: list[Login]
    limit_s: float
    """Wall time for which each waits to be accepted"""


class AlteredConnections(Struct, frozen=True, kw_only=True, tag=True):
    """Connect to a radio through a relay that alters bytes, and send batches where that succeeds."""

    login: Login
    station: int
    connections: int
    seed: int


class BatchFlood(Struct, frozen=True, kw_only=True, tag=True):
    """Send a guest's batches as fast as the connection takes them."""

    login: Login
    station: int
    count: int


class KeyExpressions(Struct, frozen=True, kw_only=True, tag=True):
    """Declare names at the radio's router, as many as asked for, and keep them until the end."""

    login: Login
    count: int


class IdleConnections(Struct, frozen=True, kw_only=True, tag=True):
    """Keep connections to ports, from the moment at which these listen, until the end of the attack."""

    streams_to: list[Address]
    count: int
    """To each of them"""
    introduction: bytes
    """What every second of them sends at once"""


class SteadyDatagrams(Struct, frozen=True, kw_only=True, tag=True):
    """Send valid messages to a port at a rate, until the end of the attack."""

    datagrams_to: Address
    rate_s: float
    sockets: int = 1
    """From which they are sent in turn"""
    one_port: bool = False
    """Whether all sockets have one port, each at another address of 127.0.0.0/8"""


class OpenEverything(Struct, frozen=True, kw_only=True, tag=True):
    """Try to read and write files and folders, to connect to sockets, and to signal processes."""

    paths: list[str]
    sockets: list[str]
    pids: list[int]


class RunOnCluster(Struct, frozen=True, kw_only=True, tag=True):
    """Try to run a function on the processes of a campaign's cluster, without its key."""

    ports: list[int]


Task = (
    RandomBytes
    | MutatedMavlink
    | ForgedBatches
    | RefusedLogins
    | AlteredConnections
    | BatchFlood
    | KeyExpressions
    | IdleConnections
    | SteadyDatagrams
    | OpenEverything
    | RunOnCluster
)


class Order(Struct, frozen=True, kw_only=True):
    """A task and the user that performs it."""

    task: Task
    uid: int | None = None
    """None: the user of the study"""


class Report(Struct, frozen=True, kw_only=True):
    """What an attack has done: numbers by their names, and findings, which are faults of coflight."""

    counts: dict[str, int] = {}
    found: list[str] = []
