"""Random mutations of valid input files."""

import re
from random import Random

import yaml

from tests.oracles.journals import mutated

WORDS = (
    b"nan", b".inf", b"-1", b"0", b"1e999", b"1e-300", b"9" * 50, b"~", b"[", b"{", b"]]", b"&a",
    b"*a", b"!!python/object:os.system", b"<<: *a", b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"\r",
    b"\n", b"\t", b",", b";", b'"', b"'", b"#", b":", b": ", b"- ", b"|", b"%YAML 9.9", b"---",
    b"true", b"null", b"\x1b[2J", b"\xe2\x80\xae", b"1,5", b"12:30", b"0x1F", b"()", b"\\u0000",
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")


class Refused(Exception):
    """The input was refused with a message."""


def refuse(problem: str) -> None:
    if problem:
        raise Refused(problem)


def bytes_changed(raw: bytes, rng: Random) -> bytes:
    data = bytearray(raw)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(9):
            case 0 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 1:
                data[at:at] = rng.choice(WORDS)
            case 2:
                del data[at : at + rng.choice((1, 5, 50, 500))]
            case 3:
                end = at + rng.choice((1, 20, 200))
                data[at:at] = data[at:end]
            case 4:
                del data[at:]
            case 5:
                lines = bytes(data).split(b"\n")
                one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
                lines[one], lines[other] = lines[other], lines[one]
                data = bytearray(b"\n".join(lines))
            case 6:
                data[at : at + 3] = rng.randbytes(3)
            case _:
                numbers = list(NUMBER.finditer(bytes(data)))
                if numbers:
                    number = rng.choice(numbers)
                    data[number.start() : number.end()] = rng.choice(WORDS)
    return bytes(data)


def in_yaml(raw: bytes, rng: Random) -> bytes:
    if rng.random() < 0.5:
        return bytes_changed(raw, rng)
    document = mutated(yaml.safe_load(raw), rng)
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True).encode(
        "utf-8", "surrogatepass"
    )
