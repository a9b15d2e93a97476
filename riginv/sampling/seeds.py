"""Random generators that depend on nothing but a seed and a place."""

import hashlib

import torch


def generator_at(seed: int, *place: int | str, device: torch.device | str = "cpu") -> torch.Generator:
    """A generator for one place (a set's name, a step's number) under a seed: the same there whatever was drawn before.

    This is what lets a run that was stopped go on exactly where it would have been, and keeps test sets apart from training.
    """
    digest = hashlib.sha256(repr((seed, *place)).encode()).digest()
    return torch.Generator(device).manual_seed(int.from_bytes(digest[:8], "little") >> 1)
