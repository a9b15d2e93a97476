"""Avatars in glTF against a plain evaluation of what was written into them."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.rig_contract import check_rig
from rigs.gltf import GltfRig
from tests.avatars import AvatarWriter, face_avatar


def test_a_realistic_avatar_comes_back_to_float_precision(face, tmp_path):
    rig = GltfRig(str(face_avatar(tmp_path / "head.glb", face, 60)))
    assert rig.control_names == face.coefficient_names[:60] and rig.primary_count == 60 and rig.name == "head"
    weights = torch.rand(4, 60, dtype=torch.float64)
    expected = face.rest_vertices.double() + torch.einsum("bk,kvc->bvc", weights, face.basis[:60].double())
    assert (rig(weights) - expected).abs().max() < 1e-3
    assert torch.equal(rig.faces, face.faces)
    check_rig(rig)
