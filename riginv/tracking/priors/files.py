"""Priors as files: numbers as safetensors, and beside them, in the same folder, what they belong to as YAML."""

from pathlib import Path
from typing import Any

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from riginv.errors import InputError, in_short
from riginv.rig.identity import check_same_rig, describe
from riginv.rig.interface import LinearRig
from riginv.runs.files import atomic_write, check_regular, read_yaml
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import ControlPrior

NUMBERS, FACTS = "prior.safetensors", "prior.yaml"
VERSION = 1
LARGEST = 1 << 28  # bytes of the numbers: 4,000 controls


def save_prior(folder: Path, prior: ControlPrior, rig: LinearRig, frames: int) -> None:
    """Write a prior as a folder, atomically.

    Args:
        rig: whose controls they are; the folder holds its identity.
        frames: that it was learned from.
    """
    facts = {"riginv_prior": VERSION, "source": prior.source, "frames": frames, "rig": describe(rig, {})}
    with atomic_write(folder) as beside:
        beside.mkdir()
        numbers = {"mean": prior.mean, "covariance": prior.covariance, "changes": prior.changes}
        save_file({name: values.contiguous() for name, values in numbers.items() if values is not None}, beside / NUMBERS)
        (beside / FACTS).write_text(yaml.safe_dump(facts, sort_keys=False), encoding="utf-8")


def load_prior(folder: Path, rig: LinearRig) -> ControlPrior:
    """A prior of a rig; errors as `read_prior`."""
    return read_prior(folder, rig)[1]


def read_prior(folder: Path, rig: LinearRig | None) -> tuple[dict[str, Any], ControlPrior]:
    """The facts of a prior as its file has them, and the prior.

    Args:
        rig: that it should be of; None: any.

    Raises:
        InputError: it is missing or damaged, or belongs to another rig.
    """
    facts = read_yaml(folder / FACTS)
    if facts.get("riginv_prior") != VERSION or not isinstance(facts.get("rig"), dict):
        raise InputError(f"{folder / FACTS}: no prior of this version of riginv: learn it again with riginv.learn_prior")
    try:
        if rig is not None:
            check_same_rig(str(folder), facts["rig"], rig)
        controls = rig.control_names if rig else tuple(str(control["name"]) for control in facts["rig"]["controls"])
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise InputError(f"{folder / FACTS}: damaged ({in_short(error)}): learn the prior again") from None
    path, count = folder / NUMBERS, len(controls)
    try:
        check_regular(path)
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: {path.stat().st_size:,} bytes, expected those of {count} controls")
        read = load_file(path)
        mean, covariance = read["mean"].double(), read["covariance"].double()
        changes = read["changes"].double() if "changes" in read else None  # older priors have none
    except (OSError, SafetensorError, KeyError) as error:
        raise InputError(f"{path}: cannot be read ({in_short(error)}): learn the prior again") from None
    if mean.shape != (count,) or covariance.shape != (count, count):
        raise InputError(
            f"{path}: mean {tuple(mean.shape)} and covariance {tuple(covariance.shape)}, expected {count} controls"
        )
    if changes is not None:
        changes = _checked(path, "changes", changes, count)
    if not bool(torch.isfinite(mean).all()):
        raise InputError(f"{path}: its mean is not finite: damaged; learn the prior again")
    source = str(facts.get("source", ""))[:200]
    return facts, ControlPrior(controls, mean, _checked(path, "covariance", covariance, count), source, changes)


def _checked(path: Path, name: str, matrix: Tensor, count: int) -> Tensor:
    """A covariance as read, symmetric.

    Raises:
        InputError: it has another shape or is not positive definite.
    """
    if matrix.shape != (count, count):
        raise InputError(f"{path}: {name} {tuple(matrix.shape)}, expected {count} controls")
    matrix = (matrix + matrix.T) / 2
    if not bool(torch.isfinite(matrix).all()) or torch.linalg.cholesky_ex(matrix)[1] != 0:
        raise InputError(f"{path}: its {name} is not positive definite: damaged; learn the prior again")
    return matrix


def prior_or_default(path: str | None, rig: LinearRig) -> tuple[ControlPrior, str]:
    """The prior in a folder or the rig's default one, and a note.

    Raises:
        InputError: as `load_prior`.
    """
    if path is not None:
        prior = load_prior(Path(path), rig)
        return prior, f"prior of {path}: {prior.source}"
    return default_prior(rig), "no prior=DIR was given: the default prior is used, learned from simulated performances"
