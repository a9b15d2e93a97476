"""Batches of poses, and the random generators that draw them."""

import hashlib
from typing import Any, TypedDict, cast

import torch
from torch import Tensor


def generator_at(seed: int, *place: int | str, device: torch.device | str = "cpu") -> torch.Generator:
    """A generator for one place (a set's name, a step's number) under a seed: the same there whatever was drawn before.

    This is what lets a run that was stopped go on exactly where it would have been, and keeps test sets apart from training.
    """
    digest = hashlib.sha256(repr((seed, *place)).encode()).digest()
    return torch.Generator(device).manual_seed(int.from_bytes(digest[:8], "little") >> 1)


class PoseBatch(TypedDict, total=False):
    """A batch to train on.

    Attributes:
        coordinates: mesh coordinates `(batch, coordinate)`.
        controls: the controls that made them, `(batch, control)`; only where the meshes are poses of the rig.
        coefficients: the rig's own at these controls, `(batch, coefficient)`; only there, too.
    """

    coordinates: Tensor
    controls: Tensor
    coefficients: Tensor


def split_batch(batch: PoseBatch, sizes: int | list[int]) -> list[PoseBatch]:
    """A batch cut into batches of a size each, or of these sizes."""
    parts: dict[str, Any] = {key: torch.split(values, sizes) for key, values in batch.items()}  # type: ignore[arg-type]
    return [cast(PoseBatch, dict(zip(parts, rows))) for rows in zip(*parts.values())]
