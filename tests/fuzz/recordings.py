"""Takes and recordings to fuzz: intact files, mutators, and code that reads them and uses their content."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import tempfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.retarget import anonymise
from facemime.core.errors import FacemimeError
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.coefficient_table import from_coefficient_csv, write_coefficient_csv
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.format import HEADER, MARKER, chunk_bytes, chunks_in
from facemime.core.takes.mending import bridge_gaps, mirror_take, remove_outliers
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.recordings import read_recording
from facemime.core.takes.smooth import smooth_zero_phase
from facemime.core.takes.spreadsheet import from_csv, to_csv
from facemime.core.takes.take import Take, check_take
from facemime.core.takes.timing import resample, restart, trim
from tests.helpers.recordings import audio2face, face_cap, openface, unity
from tests.helpers.takes import coefficient_take, performance

from .mutators import mutated_bytes, mutated_json


@cache
def _take_bytes() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        save_take(performance(), Path(folder) / "take.facetake")
        return (Path(folder) / "take.facetake").read_bytes()


def _mutated_take(rng: Random) -> bytes:
    if rng.random() < 0.3:
        return mutated_bytes(rng, _take_bytes())
    out = b""
    chunks = list(chunks_in(_take_bytes()))
    changed = rng.randrange(len(chunks))
    for number, chunk in enumerate(chunks):
        content, count, first = chunk.content, chunk.count, chunk.first
        if number == changed:
            if chunk.kind != b"F":
                content = mutated_json(rng, json.loads(content))
            elif rng.random() < 0.7:
                times, table = content[: 8 * count], zlib.decompress(content[8 * count :])
                table = bytes(50_000_000) if rng.random() < 0.02 else mutated_bytes(rng, table)
                content = (mutated_bytes(rng, times) if rng.random() < 0.3 else times) + zlib.compress(table)
            else:
                content, count = mutated_bytes(rng, content), rng.choice((count, 0, 1, 256, 65535))
                first = rng.choice((first, 0, 10**6, 2**32 - 1))
        out += chunk_bytes(chunk.kind, content, count=count, first=first)
    if rng.random() < 0.05:
        out += rng.choice((MARKER, out[: HEADER.size])) * 10_000
    return out


def _read_take(path: Path) -> None:
    _use(load_take(path))


_USES: tuple[Callable[[Take], Any], ...] = (
    lambda take: HeadDriver(built_in_head(), calibrate(take)).frame(take.result(int(take.found.argmax()))),
    mirror_take,
    lambda take: remove_outliers(bridge_gaps(take)),
    smooth_zero_phase,
    lambda take: resample(take, 30.0),
    restart,
    anonymise,
    lambda take: trim(take, 0.2, 1.0),
)


def _use(take: Take) -> None:
    """Use a take in one of several ways; errors have to be FacemimeErrors."""
    check_take(take)
    with contextlib.suppress(FacemimeError):
        _USES[zlib.crc32(take.times.tobytes() + take.shape.tobytes()) % len(_USES)](take)


@cache
def _csv_bytes() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        to_csv(performance(8), Path(folder) / "take.csv")
        return (Path(folder) / "take.csv").read_bytes()


def _mutated_csv(rng: Random) -> bytes:
    if rng.random() < 0.4:
        return mutated_bytes(rng, _csv_bytes())
    rows = list(csv.reader(io.StringIO(_csv_bytes().decode())))
    for _ in range(rng.randint(1, 3)):
        row = rng.choice(rows)
        if row:
            cells = ("", "nan", "inf", "-1e400", "1" * 500, "0x1", "-1", "word", '"', "time", "pitch")
            row[rng.randrange(len(row))] = rng.choice(cells)
        if rng.random() < 0.2:
            rng.shuffle(rows)
    stream = io.StringIO()
    csv.writer(stream).writerows(rows)
    return stream.getvalue().encode()


def _read_csv(path: Path) -> None:
    _use(from_csv(path))


@cache
def _coefficient_csv_bytes() -> bytes:
    take = coefficient_take(8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.csv"
        write_coefficient_csv(path, take.times, take.coefficients, take.pose[:, 1:4], live_link=True)
        return path.read_bytes()


def _mutated_coefficient_csv(rng: Random) -> bytes:
    return mutated_bytes(rng, _coefficient_csv_bytes())


def _read_coefficient_csv(path: Path) -> None:
    _use(from_coefficient_csv(path))


def _texts(
    suffix: str, text: str
) -> tuple[str, Callable[[], bytes], Callable[[Random], bytes], Callable[[Path], None]]:
    """Return a recording of another program as text, and its damaged copies."""
    return suffix, text.encode, lambda rng: mutated_bytes(rng, text.encode()), lambda path: _use(read_recording(path))


_KEYS = [(0, 0, 0, "Infinity"), (0.5, 100, "Infinity", 50), (1, 0, 0, 0)]
TAKES = {
    "take": (".facetake", _take_bytes, _mutated_take, _read_take),
    "take csv": (".csv", _csv_bytes, _mutated_csv, _read_csv),
    "coefficient csv": (".csv", _coefficient_csv_bytes, _mutated_coefficient_csv, _read_coefficient_csv),
    "audio2face": _texts(".json", audio2face(list(COEFFICIENTS), [[0.1] * 52, [0.5] * 52])),
    "face cap": _texts(".txt", face_cap([(i * 16, (1, 2, 3), {"jawOpen": 0.1 * i}) for i in range(8)])),
    "openface": _texts(".csv", openface([{"AU26_r": i, "pose_Rx": 0.1 * i} for i in range(5)])),
    "unity clip": _texts(".anim", unity([("Body", f"blendShape.{name}", _KEYS) for name in COEFFICIENTS[:12]])),
}
"""Suffix, intact bytes, damaged bytes, and what reads them."""
