"""What a folder holds, so that two can be compared byte by byte, and what may differ left out: how long things took."""

import hashlib
import json
from pathlib import Path

import yaml

TIMES = ("checkpoints/", "events.out.tfevents", ".lock")


def contents(folder: Path) -> dict[str, str]:
    """A digest of every file, by its name in the folder. Half-written files count: they must be gone."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {path: path.relative_to(folder).as_posix() for path in files}
    return {name: _digest(path) for path, name in names.items() if not any(part in name for part in TIMES)}


def _digest(path: Path) -> str:
    content = path.read_bytes()
    if path.name == "metrics.json":
        content = _without(json.loads(content), "train/seconds")
    if path.name == "bundle.yaml":
        description = yaml.safe_load(content)
        description["training"].pop("seconds", None)
        content = _without(description)
    if path.name == "SHA256SUMS":
        content = b"".join(line for line in content.splitlines(True) if not line.endswith(b"bundle.yaml\n"))
    return hashlib.sha256(content).hexdigest()


def _without(facts: dict, *keys: str) -> bytes:
    return json.dumps({key: value for key, value in facts.items() if key not in keys}).encode()
