"""The CRC-32 of PX4, in which stations compare parameters, plans and files with what they have."""

import zlib

_ALL_ONES = 0xFFFF_FFFF


def crc32(data: bytes, before: int = 0) -> int:
    """CRC-32 of polynomial 0xEDB88320 begun with 0 and not inverted; ``before``: that of the data ahead.

    It is zlib's but for the two inversions at its ends, which are undone here.
    """
    return zlib.crc32(data, before ^ _ALL_ONES) ^ _ALL_ONES
