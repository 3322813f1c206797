"""Size of the attacks of the study."""

from msgspec import Struct


class AttacksPlan(Struct, frozen=True, kw_only=True):
    """Size of the attacks; `cli` runs them one section after the other."""

    random_bytes: int = 1_000_000_000
    """Over all ports, sockets and flights of the section"""
    small_datagrams: int = 1_000_000
    """Datagrams of at most `MOST_SMALL_BYTES` among them"""
    mavlink_rounds: int = 20
    """Rounds over all messages of the dialect"""
    forged_batches: int = 1_000
    altered_connections: int = 200
    """Connections to the radio with altered bytes, in each flight"""
    flood_messages: int = 3_000_000
    key_expressions: int = 10_000
    """Names that a guest declares at the radio's router, which keeps them"""
    idle_connections: int = 100
    datagrams_s: float = 15_000.0
    many_sockets: int = 10_000
    """Sockets of another user from which datagrams come in turn; tables of sockets are long then"""
    many_sockets_datagrams_s: float = 1_000.0
    pairs: int = 5
    """Pairs of flights, without and with datagrams"""
    pair_s: float = 20.0
    """Simulated time of each of these flights"""
    least_s: float = 5.0
    """Simulated time of an attacked flight at least, from the begin of the attack on"""


QUICK_ATTACKS = AttacksPlan(
    random_bytes=1_000_000,
    small_datagrams=2_000,
    mavlink_rounds=1,
    forged_batches=50,
    altered_connections=10,
    flood_messages=10_000,
    key_expressions=2_000,
    idle_connections=20,
    many_sockets=5_000,
    pairs=1,
    pair_s=3.0,
    least_s=2.0,
)
