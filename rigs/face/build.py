"""Geometry of the face as tensors, built from the asset and cached."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv.rig import arkit
from riginv.runs.cache import cached_tensors, code_key
from rigs.face.combinations import repair
from rigs.face.inbetweens import build_inbetweens
from rigs.face.shapes import build_primaries
from rigs.geometry.asset import PATH, FaceSource, read_asset

HERE = Path(__file__).parent


def face_geometry() -> dict[str, Tensor]:
    """The tensors of the face, cached by a key of the code that builds them.

    Returns:
        rest_vertices `(vertex, 3)` and basis `(coefficient, vertex, 3)`, mm; faces `(face, 3)`; part `(vertex,)`, indices into
        `PARTS`; inbetween_shape and inbetween_position `(in-between,)`; combination_members `(combination, 3)`, -1 for none.
    """
    sources = [HERE, Path(arkit.__file__), PATH.with_name("asset.py"), PATH]
    return cached_tensors("face", code_key(sources), build_geometry)


def build_geometry() -> dict[str, Tensor]:
    """Build what `face_geometry` returns, without the cache."""
    arrays = read_asset()
    face = FaceSource(arrays)
    primaries = build_primaries(face)
    names, members = list(primaries), arrays["combination_members"].astype(np.int64)
    inbetweens = build_inbetweens(primaries, face.rest, face.normals, face.parts)
    combinations = [repair(tuple(names[shape] for shape in group if shape >= 0), primaries) for group in members]
    basis = [*primaries.values(), *(shape.deltas for shape in inbetweens), *combinations]
    return {
        "rest_vertices": torch.tensor(face.rest, dtype=torch.float32),
        "faces": torch.tensor(arrays["face_faces"].astype(np.int64)),
        "part": torch.tensor(face.parts.astype(np.int64)),
        "basis": torch.tensor(np.stack(basis), dtype=torch.float32),
        "inbetween_shape": torch.tensor([names.index(shape.shape) for shape in inbetweens]),
        "inbetween_position": torch.tensor([shape.position for shape in inbetweens], dtype=torch.float64),
        "combination_members": torch.tensor(members),
    }
