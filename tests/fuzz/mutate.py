"""Changes that break formats: cuts, flips, insertions, numbers at the limits; the same for the same seed."""

from __future__ import annotations

import random

BINARY = [
    b"\xff" * 8,
    bytes(8),
    b"\xff\xff\xff\x7f",
    b"\0\0\0\x80",
    b"\0\0\0\0\0\0\xf0\x7f",
    b"\0\0\0\0\0\0\xf8\x7f",
    b"\0\0\x80\x7f",
    b"\0\0\xc0\x7f",
    b"\x01",
]
TEXT = [*b"nan inf -1 1e400 4294967296 18446744073709551615 99999999999".split(), b" ", b"\n"]
TEXT += [*b'\0 \xff null [] {} " ../'.split(), b"\n\n"]


def mutated(seed: bytes, chance: random.Random) -> bytes:
    """The seed with one to four changes; half of them near its beginning, where headers and counts are."""
    data = bytearray(seed)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        if not data:
            break
        at = chance.randrange(min(len(data), chance.choice((80, 500, len(data)))))
        kind = chance.randrange(6)
        if kind == 0:
            data[at] = chance.randrange(256)
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            value = chance.choice(BINARY + TEXT)
            data[at : at + len(value)] = value
        elif kind == 3:
            data[at:at] = chance.choice(BINARY + TEXT)
        elif kind == 4:
            del data[at : at + chance.randrange(1, 40)]
        else:
            other = chance.randrange(len(data))
            data[at:at] = data[other : other + chance.randrange(1, 80)]
    return bytes(data)
