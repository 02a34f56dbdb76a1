"""Pose files as they should not be: sound sessions damaged at random. Knows the format, not its reader."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tests.oracles.shop_floor import Session, session
from tests.oracles.shop_floor_walk import LOWER_DEG, UPPER_DEG

CELLS = ("", "nan", "inf", "-inf", "1e400", "abc", "12,5", "0x10", "--3", "1e308", "-0.0", "é", " ")


@dataclass(frozen=True, kw_only=True)
class Damaged:
    """A file's bytes, what was done to it, the options it is solved with.

    `nonsense` says that no reading in it has to do with an arm: no answer may be accepted.
    """

    data: bytes
    ways: tuple[str, ...]
    options: tuple[str, ...]
    nonsense: bool


Table = dict[str, np.ndarray]
Rng = np.random.Generator


@lru_cache(maxsize=8)
def _sound(seed: int) -> Session:
    return session(seed)


def _random_in_range(q: np.ndarray, rng: Rng) -> np.ndarray:
    return rng.uniform(LOWER_DEG, UPPER_DEG, q.shape)


def _random_anywhere(q: np.ndarray, rng: Rng) -> np.ndarray:
    return rng.uniform(-360.0, 360.0, q.shape)


def _shuffled_columns(q: np.ndarray, rng: Rng) -> np.ndarray:
    """Every joint's readings in an order of their own."""
    return np.stack([rng.permutation(c) for c in q.T], axis=-1)


NONSENSE: dict[str, Callable[[np.ndarray, Rng], np.ndarray]] = {
    "random readings": _random_in_range,
    "random angles": _random_anywhere,
    "shuffled columns": _shuffled_columns,
    "all alike": lambda q, _: np.repeat(q[:1], len(q), axis=0),
    "zeros": lambda q, _: np.zeros_like(q),
    "huge": lambda q, rng: q * 10.0 ** rng.uniform(3, 300),
}


def _columns_exchanged(q: np.ndarray, rng: Rng) -> np.ndarray:
    return q[:, rng.permutation(7)]


def _signs(q: np.ndarray, rng: Rng) -> np.ndarray:
    return q * rng.choice((-1.0, 1.0), 7)


def _still(q: np.ndarray, rng: Rng) -> np.ndarray:
    q[:, rng.integers(7, size=rng.integers(1, 4))] = q[0, 0]
    return q


def _noisy(q: np.ndarray, rng: Rng) -> np.ndarray:
    return q + 10.0 ** rng.uniform(-4, 2) * rng.normal(size=q.shape)


def _spikes(q: np.ndarray, rng: Rng) -> np.ndarray:
    for _ in range(rng.integers(1, 8)):
        q[rng.integers(len(q)), rng.integers(7)] += 10.0 ** rng.uniform(-1, 6) * rng.normal()
    return q


def _turns(q: np.ndarray, rng: Rng) -> np.ndarray:
    q[rng.random(q.shape) < 0.1] += 360.0
    return q


def _tiny(q: np.ndarray, rng: Rng) -> np.ndarray:
    return q[0] + (q - q[0]) * 10.0 ** rng.uniform(-8, -1)


def _pasted(q: np.ndarray, rng: Rng) -> np.ndarray:
    return np.concatenate([q] * int(rng.integers(2, 6)))


def _few(q: np.ndarray, rng: Rng) -> np.ndarray:
    return q[: rng.integers(1, 6)]


def _drift(q: np.ndarray, rng: Rng) -> np.ndarray:
    return q + np.linspace(0.0, 1.0, len(q))[:, None] * rng.normal(size=7)


def _step(q: np.ndarray, rng: Rng) -> np.ndarray:
    q[rng.integers(len(q)) :, rng.integers(7)] += 10.0 ** rng.uniform(-2, 2)
    return q


def _held(q: np.ndarray, rng: Rng) -> np.ndarray:
    k, j = rng.integers(len(q)), rng.integers(7)
    q[k:, j] = q[k, j]
    return q


WRONG: dict[str, Callable[[np.ndarray, Rng], np.ndarray]] = {
    "columns exchanged": _columns_exchanged,
    "signs": _signs,
    "still joints": _still,
    "noise": _noisy,
    "spikes": _spikes,
    "whole turns": _turns,
    "tiny motion": _tiny,
    "pasted again": _pasted,
    "few poses": _few,
    "drift": _drift,
    "step": _step,
    "frozen": _held,
    "radians": lambda q, _: np.deg2rad(q),
    "milliradians": lambda q, _: 1e3 * np.deg2rad(q),
    "upside down": lambda q, _: q[::-1],
    "nothing": lambda q, _: q,
}


def _lines(q: np.ndarray, rng: Rng) -> list[list[str]]:
    head = ["placement", "pose", *(f"theta{j}_deg" for j in range(1, 8))]
    kind = rng.random()
    extra = rng.random() < 0.5
    if extra:
        head += [*(f"sd{j}_deg" for j in range(1, 8)), "samples"]
    rows = [head]
    for k, pose in enumerate(q):
        placement = "1" if kind < 0.9 else str(1 + k % 2)
        row = [placement, f"p{k + 1}", *(repr(float(v)) for v in pose)]
        if extra:
            size = 10.0 ** rng.uniform(-9, 3)
            row += [*(repr(float(v)) for v in size * rng.random(7)), str(int(rng.integers(1, 99)))]
        rows.append(row)
    return rows


def _torn(rows: list[list[str]], rng: Rng) -> bytes:
    """Damage cells, rows, the header or the bytes of the file."""
    way = rng.integers(8)
    k, j = int(rng.integers(len(rows))), int(rng.integers(len(rows[0])))
    if way == 0:
        rows[k][j] = str(rng.choice(CELLS))
    elif way == 1:
        del rows[k][j]
    elif way == 2:
        rows[k].append("1.0")
    elif way == 3:
        rows.append(list(rows[k]))
    elif way == 4:
        del rows[0]
    elif way == 5:
        rows = [[*row[:j], *row[j + 1 :]] for row in rows]
    text = "\n".join(",".join(row) for row in rows) + "\n"
    data = text.encode()
    if way == 6:
        cut = int(rng.integers(len(data)))
        data = data[:cut]
    elif way == 7:
        at = int(rng.integers(len(data)))
        data = data[:at] + bytes(rng.integers(0, 256, 5, dtype=np.uint8)) + data[at + 5 :]
    return data


def _options(rng: Rng) -> tuple[str, ...]:
    found: list[str] = []
    if rng.random() < 0.7:
        found.append("--json")
    draw = rng.random()
    if draw < 0.1:
        found += ["--estimator", "paper"]
    elif draw < 0.2:
        found += ["--unsensed", str(rng.choice(("6", "7", "6,7", "1", "3,6")))]
    elif draw < 0.3:
        found.append("--drop-unidentifiable")
    elif draw < 0.4:
        found.append("--global-start")
    elif draw < 0.45:
        found.append("--checks")
    elif draw < 0.52:
        found += ["--fixture", str(rng.choice(("rigid", "ball")))]
    elif draw < 0.55:
        found += ["--arm", "franka_panda"]
    return tuple(found)


def damaged(seed: int) -> Damaged:
    """Return one set."""
    rng = np.random.default_rng([88_001, seed])
    q = np.rad2deg(_sound(int(rng.integers(6))).readings)
    q = q[: int(rng.choice((8, 20, 40)))].copy()
    ways, nonsense = [], False
    if rng.random() < 0.25:
        way = str(rng.choice(list(NONSENSE)))
        q, nonsense = NONSENSE[way](q, rng), True
        ways.append(way)
    else:
        for way in rng.choice(list(WRONG), size=rng.integers(1, 3), replace=False):
            q = WRONG[str(way)](np.array(q), rng)
            ways.append(str(way))
    rows = _lines(q, rng)
    if rng.random() < 0.2:
        data = _torn(rows, rng)
        ways.append("torn file")
    else:
        data = ("\n".join(",".join(row) for row in rows) + "\n").encode()
    return Damaged(data=data, ways=tuple(ways), options=_options(rng), nonsense=nonsense)
