"""Batches of poses, and the random generators that draw them."""

import hashlib
from collections.abc import Callable
from typing import Any, TypedDict, cast

import torch
from torch import Tensor


def generator_at(seed: int, *key: int | str, device: torch.device | str = "cpu") -> torch.Generator:
    """A random generator that depends on nothing but a seed and a key, such as a set's name or a step's number.

    So an interrupted run continues with identical results, and evaluation sets are independent of training.
    """
    return torch.Generator(device).manual_seed(seed_at(seed, *key))


def seed_at(seed: int, *key: int | str) -> int:
    """The seed of `generator_at`."""
    digest = hashlib.sha256(repr((seed, *key)).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


class PoseBatch(TypedDict, total=False):
    """A training batch.

    Attributes:
        coordinates: mesh coordinates `(batch, coordinate)`.
        controls: the controls that made them, `(batch, control)`; only where the meshes are poses of the rig.
        known_controls: the same, NaN for the meshes of a mixture that are no poses of the rig.
        coefficients: the rig's coefficients at these controls, `(batch, coefficient)`; only there, too.
    """

    coordinates: Tensor
    controls: Tensor
    known_controls: Tensor
    coefficients: Tensor


def known_controls(batch: PoseBatch) -> Tensor | None:
    """The controls that made a batch, `(batch, control)`, NaN for meshes that are no poses of the rig; None: all are none."""
    return batch.get("known_controls", batch.get("controls"))


def map_batches(function: Callable[..., Tensor], *batches: PoseBatch) -> PoseBatch:
    """Apply a function to the tensors of batches, key by key; keys that are not in all of them are left out."""
    common = [key for key in batches[0] if all(key in batch for batch in batches)]
    return cast(PoseBatch, {key: function(*(cast(dict, batch)[key] for batch in batches)) for key in common})


def split_batch(batch: PoseBatch, sizes: int | list[int]) -> list[PoseBatch]:
    """A batch cut into batches of a size each, or of these sizes."""
    parts: dict[str, Any] = {key: torch.split(values, sizes) for key, values in batch.items()}  # type: ignore[arg-type]
    return [cast(PoseBatch, dict(zip(parts, rows))) for rows in zip(*parts.values())]
