"""PX4's CRC-32, by which stations compare parameters, plans and files with cached ones."""

import zlib

_ALL_ONES = 0xFFFF_FFFF


def crc32(data: bytes, before: int = 0) -> int:
    """CRC-32 with polynomial 0xEDB88320, initial value 0, not inverted; ``before``: CRC of preceding data.

    It equals zlib's without the inversions of initial and final value, which are undone here.
    """
    return zlib.crc32(data, before ^ _ALL_ONES) ^ _ALL_ONES
