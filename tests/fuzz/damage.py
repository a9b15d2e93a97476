"""Harm of kinds that happen, or that somebody does on purpose: the same for a seed, on every machine."""

import re

import numpy as np

NUMBER = re.compile(rb"-?\d+(\.\d+)?")
WORDS = (
    b"null",
    b"true",
    b"[]",
    b"{}",
    b"-1",
    b"0",
    b"1e999",
    b"nan",
    b"99999999999999999999",
    b'""',
    b"!!python/object:os.system []",
)


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes flipped, cut, doubled, zeroed, random or set, most often near the start; of text also words and lines."""
    content = bytearray(data)
    is_text = b"\0" not in data[:4000]
    for _ in range(int(random.integers(1, 4))):
        size = len(content)
        if not size:
            return b""
        place = int(min(random.exponential(120), size - 1)) if random.random() < 0.6 else int(random.integers(size))
        length = int(min(random.integers(1, 24), size - place))
        kind = random.integers(10 if is_text else 7)
        if kind == 0:
            content[place] ^= 1 << int(random.integers(8))
        elif kind == 1:
            del content[place:]
        elif kind == 2:
            content[place : place + length] = random.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 3:
            content[place : place + length] = b"\0" * length
        elif kind == 4:
            content[place:place] = content[place : place + length]
        elif kind == 5:
            del content[place : place + length]
        elif kind == 6:
            content[place : place + length] = b"\xff" * length
        elif kind == 7:
            content = _other_number(content, random)
        elif kind == 8:
            lines = bytes(content).split(b"\n")
            line = int(random.integers(len(lines)))
            lines[line : line + 1] = [[], [lines[line]] * 2, [lines[line].rpartition(b":")[0] + b": " + _word(random)]][
                random.integers(3)
            ]
            content = bytearray(b"\n".join(lines))
        else:
            content[place : place + length] = _word(random)
    return bytes(content)


def _other_number(content: bytearray, random: np.random.Generator) -> bytearray:
    found = list(NUMBER.finditer(bytes(content)))
    if found:
        one = found[int(random.integers(len(found)))]
        content[one.start() : one.end()] = _word(random)
    return content


def _word(random: np.random.Generator) -> bytes:
    return WORDS[int(random.integers(len(WORDS)))]
