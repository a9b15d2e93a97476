"""The contents of the page of an inversion, read without a browser."""

import base64
import gzip
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Page(NamedTuple):
    """The facts of a page, and of each of its scans: points `(point, 3)` and distances `(point,)`, mm, and faces."""

    facts: dict[str, Any]
    scans: list[tuple[np.ndarray, np.ndarray, np.ndarray]]


def read_page(path: Path) -> Page:
    """Read a page; its scans are unpacked as scene.js does."""
    parts = dict(re.findall(r'<script type="[^"]*" id="(\w+)">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL))
    facts, data = json.loads(parts["facts"]), gzip.decompress(base64.b64decode(parts["scans"]))
    points, triangles, _ = np.array(facts["scans"]).reshape(-1, 3).sum(axis=0)
    kinds = [("<i2", 3 * points), ("<u2", points), ("<u2", 3 * triangles), ("i1", 3 * points)]
    arrays, start = [], 0
    for kind, count in kinds:
        arrays.append(np.frombuffer(data, kind, count, start))
        start += arrays[-1].nbytes
    assert start == len(data)
    positions, distances, faces, _ = arrays
    scans, p, f = [], 0, 0
    for count, number, _ in facts["scans"]:
        away = np.where(distances[p : p + count] == 65_535, np.nan, distances[p : p + count] * facts["step"])
        corners = faces[3 * f : 3 * (f + number)].reshape(-1, 3)
        scans.append((facts["step"] * positions[3 * p : 3 * (p + count)].reshape(-1, 3), corners, away))
        p, f = p + count, f + number
    return Page(facts, scans)
