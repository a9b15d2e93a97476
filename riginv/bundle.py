"""Bundles: a trained model as a folder of files that load without running code.

bundle.yaml            what it is: kind, network, rig (its config and its controls), training
weights.safetensors    the network's weights
space.safetensors      the mesh space: rest vertices, frame, faces; the linear map from coefficients
rig/                   only of an inverse that was trained through a surrogate: that surrogate's bundle
SHA256SUMS             of all of these, as `sha256sum -c` reads it
"""

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from riginv.errors import InputError
from riginv.files import sha256, written_beside
from riginv.mesh_space import RigInMeshSpace
from riginv.networks.base import RigNetwork
from riginv.rig import Control, RigBackend

FORMAT = 1
DESCRIPTION, WEIGHTS, SPACE, RIG, SUMS = "bundle.yaml", "weights.safetensors", "space.safetensors", "rig", "SHA256SUMS"


@dataclass(frozen=True)
class Bundle:
    """A bundle that has been read and checked.

    Attributes:
        folder: where it lies.
        description: the content of bundle.yaml: `kind`, `network`, `rig`, `training`.
        weights: the network's.
        space: `rest_vertices`, `frame`, `faces`, `linear_map`.
    """

    folder: Path
    description: dict[str, Any]
    weights: dict[str, Tensor]
    space: dict[str, Tensor]

    @property
    def controls(self) -> list[Control]:
        return [Control(**control) for control in self.description["rig"]["controls"]]

    @property
    def holds_surrogate(self) -> bool:
        """Whether the rig that it was trained on is a surrogate whose bundle lies within."""
        return self.description["rig"]["config"].get("bundle") == RIG

    def check_rig(self, rig: RigBackend) -> None:
        """Raises InputError where a rig is not the one that this was trained on: its controls, limits or vertices differ."""
        expected, found = self.controls, rig.controls
        where = f"rig '{rig.name}'"
        if len(found) != len(expected):
            raise InputError(f"{where} has {len(found)} controls, the bundle was trained on {len(expected)} ({self.folder})")
        for number, (ours, theirs) in enumerate(zip(expected, found)):
            if ours != theirs:
                raise InputError(f"{where}: control {number} is {theirs}, the bundle was trained with {ours} ({self.folder})")
        vertices = len(self.space["rest_vertices"])
        if len(rig.rest_vertices) != vertices:
            raise InputError(
                f"{where} has {len(rig.rest_vertices)} vertices, the bundle was trained on {vertices} ({self.folder})"
            )


def write_bundle(
    folder: Path, kind: str, network: RigNetwork, rig: RigInMeshSpace, config: dict[str, Any], training: dict[str, Any]
) -> None:
    """Write a bundle whole or not at all.

    Args:
        kind: `inverse` or `forward`.
        config: the plain config of the run; its `rig` says what builds the rig. Where that is a surrogate of a bundle, the
            bundle is copied along.
        training: facts worth keeping: steps, seconds, seed.
    """
    with written_beside(folder) as beside:
        beside.mkdir()
        rig_config = dict(config["rig"])
        if "bundle" in rig_config:
            shutil.copytree(read_bundle(rig_config["bundle"]).folder, beside / RIG)
            rig_config["bundle"] = RIG
        description = {
            "format": FORMAT,
            "kind": kind,
            "network": config["model"]["network"],
            "rig": {
                "name": rig.rig.name,
                "config": rig_config,
                "primary_count": rig.rig.primary_count,
                "coefficient_names": list(rig.rig.coefficient_names),
                "controls": [vars(control) for control in rig.rig.controls],
            },
            "training": training,
        }
        (beside / DESCRIPTION).write_text(yaml.safe_dump(description, sort_keys=False), encoding="utf-8")
        space = {
            "rest_vertices": rig.rig.rest_vertices,
            "frame": rig.space.frame,
            "faces": rig.rig.faces,
            "linear_map": rig.linear_map,
        }
        for name, tensors in ((WEIGHTS, network.own_weights()), (SPACE, space)):
            save_file({key: value.detach().cpu().contiguous() for key, value in tensors.items()}, beside / name)
        files = sorted(path for path in beside.rglob("*") if path.is_file())
        sums = [f"{sha256(path)}  {path.relative_to(beside).as_posix()}\n" for path in files]
        (beside / SUMS).write_text("".join(sums), encoding="utf-8")


def read_bundle(folder: str | Path, kind: str | None = None) -> Bundle:
    """Read a bundle and check that it is whole.

    Args:
        kind: `inverse` or `forward`, where only that will do.

    Raises:
        InputError: there is no bundle, a file is missing, truncated or altered, or it is of another kind or format.
    """
    folder = Path(folder)
    if not (folder / SUMS).is_file() and (folder / "bundle" / SUMS).is_file():
        folder = folder / "bundle"  # a run's folder was named instead
    if not (folder / SUMS).is_file():
        raise InputError(f"{folder}: no bundle there (no {SUMS}); name the bundle/ folder of a finished run")
    sums = [line.partition("  ") for line in (folder / SUMS).read_text(encoding="utf-8", errors="replace").splitlines()]
    for name in {DESCRIPTION, WEIGHTS, SPACE} - {name for _, _, name in sums}:
        raise InputError(f"{folder / SUMS}: does not list {name}: truncated or altered; copy it again, or train it again")
    for expected, _, name in sums:
        _check_file(folder, name, expected)
    try:
        description = yaml.safe_load((folder / DESCRIPTION).read_text(encoding="utf-8"))
        weights, space = load_file(folder / WEIGHTS), load_file(folder / SPACE)
    except (OSError, ValueError, yaml.YAMLError, SafetensorError) as error:
        raise InputError(f"{folder}: the bundle cannot be read: {error}; train it again") from None
    if not isinstance(description, dict) or description.get("format") != FORMAT:
        found = description.get("format") if isinstance(description, dict) else None
        raise InputError(f"{folder / DESCRIPTION}: format {found!r}, expected {FORMAT}: made by another version of riginv")
    if kind is not None and description.get("kind") != kind:
        raise InputError(f"{folder}: a bundle of kind '{description.get('kind')}', expected '{kind}' (model={kind})")
    return Bundle(folder, description, weights, space)


def _check_file(folder: Path, name: str, expected: str) -> None:
    path = folder / name
    if not name or not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{folder / SUMS}: names a file outside the bundle or none at all: {name!r}; train it again")
    if not path.is_file():
        raise InputError(f"{path}: missing from the bundle; copy the whole folder, or train it again")
    if sha256(path) != expected:
        raise InputError(
            f"{path}: truncated or altered since it was written (SHA-256 differs); copy it again, or train it again"
        )


def is_damaged(folder: Path) -> bool:
    """Whether a finished run's bundle is no longer what was written; says so, since it is then made again."""
    try:
        read_bundle(folder)
    except InputError as error:
        print(f"{str(error).partition(';')[0]}: it is made again, from where training stood last", file=sys.stderr, flush=True)
        return True
    return False
