"""Bundles: a trained model as a folder of files that load without running code.

bundle.yaml            what it is: kind, network, rig (its config and its controls), training
weights.safetensors    the network's weights
space.safetensors      the mesh space: rest vertices, frame, faces; the linear map from coefficients
rig/                   only of an inverse that was trained through a surrogate: that surrogate's bundle
SHA256SUMS             of all of these, as `sha256sum -c` reads it
"""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from riginv.config.aliases import upgraded
from riginv.config.values import fits, in_words
from riginv.errors import InputError, in_short
from riginv.networks.base import RigNetwork
from riginv.rig.interface import Control, RigBackend
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.checksums import SUMS, sha256, write_sums
from riginv.runs.files import atomic_write, is_file, read_text, read_yaml

FORMAT = 1
DESCRIPTION, WEIGHTS, SPACE, RIG = "bundle.yaml", "weights.safetensors", "space.safetensors", "rig"
FIELDS = {"kind": Literal["inverse", "forward"], **dict.fromkeys(("network", "rig", "training"), Mapping[str, Any])}
RIG_FIELDS = {
    "name": str,
    "config": Mapping[str, Any],
    "primary_count": int,
    "coefficient_names": list[str],
    "controls": list[Mapping[str, Any]],
}
CONTROL_FIELDS = {"name": str, "lower": float, "upper": float, "neutral": float, "unit": str}
SPACE_SHAPES = {
    "rest_vertices": ("vertex", "3"),
    "frame": ("coordinate", "vertex", "3"),
    "faces": ("face", "3"),
    "linear_map": ("coefficient", "coordinate"),
}


@dataclass(frozen=True)
class Bundle:
    """A bundle that has been read and checked.

    Attributes:
        folder: of the bundle.
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
    folder: Path,
    kind: str,
    network: RigNetwork,
    rig: RigInMeshSpace,
    network_config: Mapping[str, Any],
    rig_config: Mapping[str, Any],
    training: Mapping[str, Any],
) -> None:
    """Write a bundle atomically.

    Args:
        kind: `inverse` or `forward`.
        network_config: the class of the network, and its arguments.
        rig_config: the class of the rig, and its arguments. Where it is a surrogate of a bundle, that bundle is copied along.
        training: facts worth keeping: steps, seconds, seed.
    """
    with atomic_write(folder) as beside:
        beside.mkdir()
        rig_config = dict(rig_config)
        if "bundle" in rig_config:
            copy_bundle(read_bundle(rig_config["bundle"]).folder, beside / RIG)
            rig_config["bundle"] = RIG
        description = {
            "format": FORMAT,
            "kind": kind,
            "network": dict(network_config),
            "rig": {
                "name": rig.source.name,
                "config": rig_config,
                "primary_count": rig.source.primary_count,
                "coefficient_names": list(rig.source.coefficient_names),
                "controls": [vars(control) for control in rig.source.controls],
            },
            "training": dict(training),
        }
        (beside / DESCRIPTION).write_text(yaml.safe_dump(description, sort_keys=False), encoding="utf-8")
        space = {
            "rest_vertices": rig.source.rest_vertices,
            "frame": rig.space.directions,
            "faces": rig.source.faces,
            "linear_map": rig.linear_map,
        }
        for name, tensors in ((WEIGHTS, network.own_weights()), (SPACE, space)):
            save_file({key: value.detach().cpu().contiguous() for key, value in tensors.items()}, beside / name)
        write_sums(beside)


def read_bundle(folder: str | Path, kind: str | None = None) -> Bundle:
    """Read a bundle and verify its checksums.

    Args:
        kind: `inverse` or `forward`, where only that will do.

    Raises:
        InputError: there is no bundle, a file is missing, truncated or altered, or it is of another type or format.
    """
    folder = bundle_folder(folder)
    if not is_file(folder / SUMS):
        raise InputError(
            f"{folder}: no bundle there (no {SUMS}); give the folder that riginv train named, such as "
            "runs/face-inverse/TIME, or its bundle/"
        )
    sums = _sums(folder)
    for name in {DESCRIPTION, WEIGHTS, SPACE} - {name for _, _, name in sums}:
        raise InputError(f"{folder / SUMS}: does not list {name}: truncated or altered; copy it again, or train it again")
    for expected, _, name in sums:
        _check_file(folder, name, expected)
    description = read_yaml(folder / DESCRIPTION)
    if description.get("format") != FORMAT:
        found = description.get("format")
        raise InputError(f"{folder / DESCRIPTION}: format {found!r:.40}, expected {FORMAT}: made by another version of riginv")
    _check_description(folder / DESCRIPTION, description)
    description = upgraded(description)
    try:
        weights, space = load_file(folder / WEIGHTS), load_file(folder / SPACE)
    except (OSError, ValueError, KeyError, SafetensorError) as error:
        raise InputError(f"{folder}: the bundle cannot be read: {in_short(error)}; train it again") from None
    _check_tensors(folder, weights, space)
    if kind is not None and description.get("kind") != kind:
        raise InputError(f"{folder}: a bundle of kind '{description.get('kind')}', expected '{kind}' (model={kind})")
    return Bundle(folder, description, weights, space)


def bundle_folder(folder: str | Path) -> Path:
    """The folder of a bundle, or of the run that holds it."""
    folder = Path(str(folder))
    within = folder / "bundle"
    return within if not is_file(folder / SUMS) and is_file(within / SUMS) else folder


def copy_bundle(folder: Path, to: Path) -> None:
    """Copy a bundle: only the files that its checksums name, and no links."""
    for name in [SUMS, *(name for _, _, name in _sums(folder))]:
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / name, to / name)


def _sums(folder: Path) -> list[tuple[str, str, str]]:
    return [line.partition("  ") for line in read_text(folder / SUMS).splitlines()]


def _check_file(folder: Path, name: str, expected: str) -> None:
    path = folder / name
    try:
        within = bool(name) and path.resolve().is_relative_to(folder.resolve())
        found = within and path.is_file()
    except (OSError, ValueError):
        within = found = False
    if not within:
        raise InputError(f"{folder / SUMS}: names a file outside the bundle or none at all: {name!r:.80}; train it again")
    if not found:
        raise InputError(f"{path}: missing from the bundle; copy the whole folder, or train it again")
    if sha256(path) != expected:
        raise InputError(
            f"{path}: truncated or altered since it was written (SHA-256 differs); copy it again, or train it again"
        )


def _check_description(path: Path, description: Mapping[str, Any]) -> None:
    """Raises InputError where a description lacks fields that `write_bundle` writes."""
    _check_fields(path, "", description, FIELDS)
    rig, training = description["rig"], description["training"]
    _check_fields(path, "rig.", rig, RIG_FIELDS)
    for number, control in enumerate(rig["controls"]):
        _check_fields(path, f"rig.controls[{number}].", control, CONTROL_FIELDS)
        if len(control) != len(CONTROL_FIELDS):
            raise InputError(f"{path}: rig.controls[{number}] holds more than {', '.join(CONTROL_FIELDS)}: altered")
    if not 0 <= rig["primary_count"] <= len(rig["coefficient_names"]):
        raise InputError(f"{path}: rig.primary_count is {rig['primary_count']} of {len(rig['coefficient_names'])}: altered")
    if not fits(training.get("seconds", 0.0), float):
        raise InputError(f"{path}: training.seconds is {training['seconds']!r:.80}, expected a number: altered")


def _check_fields(path: Path, where: str, found: Mapping[str, Any], fields: Mapping[str, Any]) -> None:
    for name, hint in fields.items():
        if name not in found or not fits(found[name], hint):
            what = f"is {found[name]!r:.80}" if name in found else "is missing"
            raise InputError(f"{path}: {where}{name} {what}, expected {in_words(hint)}: truncated or altered")


def _check_tensors(folder: Path, weights: Mapping[str, Tensor], space: Mapping[str, Tensor]) -> None:
    """Raises InputError where tensors have wrong shapes, or a number is not finite."""
    for name, words in SPACE_SHAPES.items():
        if name not in space or space[name].ndim != len(words) or space[name].is_floating_point() != (name != "faces"):
            raise InputError(f"{folder / SPACE}: {name} is missing or no array ({', '.join(words)}): altered; train it again")
    vertices, rank = len(space["rest_vertices"]), len(space["frame"])
    expected = {"rest_vertices": (vertices, 3), "frame": (rank, vertices, 3), "faces": (len(space["faces"]), 3)}
    expected["linear_map"] = (len(space["linear_map"]), rank)
    for name, shape in expected.items():
        if tuple(space[name].shape) != shape:
            raise InputError(f"{folder / SPACE}: {name} has shape {tuple(space[name].shape)}, expected {shape}: train it again")
    for file, tensors in ((WEIGHTS, weights), (SPACE, space)):
        for name, tensor in tensors.items():
            if tensor.is_floating_point() and not torch.isfinite(tensor.float()).all():
                raise InputError(f"{folder / file}: {name} holds NaN or infinite values: train it again")


def is_damaged(folder: Path) -> bool:
    """Whether a finished run's bundle differs from what was written; prints a warning, since it is then made again."""
    try:
        read_bundle(folder)
    except InputError as error:
        print(f"{str(error).partition(';')[0]}: it is written again from the last checkpoint", file=sys.stderr, flush=True)
        return True
    return False
