"""Any control values, in range or far out of it: a rig that is built in gives finite meshes, each by itself."""

import math

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as numbers

from riginv.rig.interface import LinearRig
from rigs.dna import DnaRig
from rigs.shapes import ShapesRig
from rigs.surrogate import SurrogateRig
from tests.fuzz.bundles import write_tiny_surrogate
from tests.rigs.dna.files import everything, written
from tests.rigs.dna.heads import many_joints
from tests.support import sculpts
from tests.support.avatars import face_avatar
from tests.support.toys import ToyRig

FAR = 1e3  # ranges: as far as a careless hand types
QUICK, MANY = 5, 400
RIGS = ("face", "body", "gltf", "joints", "shapes", "least", "surrogate", "toy", "dna", "head")


@pytest.fixture(scope="module")
def rigs(request, face, body, tmp_path_factory):
    from rigs.gltf import GltfRig

    folder = tmp_path_factory.mktemp("rigs")
    avatar = face_avatar(folder / "a.glb", face, 6, joints=True)
    sculpts.write_folder(folder / "s", a=sculpts.offset(1), b=sculpts.offset(2), a50=sculpts.offset(3), a_b=sculpts.offset(4))
    return {
        "face": face,
        "body": body,
        "gltf": GltfRig(str(avatar)),
        "joints": GltfRig(str(avatar), joints=True),
        "shapes": ShapesRig(str(folder / "s")),
        "least": ShapesRig(str(folder / "s"), combination="min"),
        "surrogate": SurrogateRig(str(write_tiny_surrogate(folder / "bundle"))),
        "toy": ToyRig(),
        "dna": DnaRig(written(folder / "tiny.dna", everything(operations=True)), "raw"),
        "head": DnaRig(written(folder / "head.dna", many_joints().file())),
    }


def shares(rig: LinearRig) -> st.SearchStrategy[np.ndarray]:
    """Where controls `(batch, control)` stand in their ranges: 0 and 1 are the limits, and nothing keeps them there."""
    usual, edges = st.floats(0, 1, width=32), st.sampled_from([0.0, 1.0, 0.5, -0.0, 1e-38, -1e-7, 1 + 1e-6])
    far = st.floats(-FAR, FAR, width=32)
    shape = numbers.array_shapes(min_dims=1, max_dims=1, min_side=1, max_side=3).map(lambda one: (*one, len(rig.controls)))
    return shape.flatmap(lambda size: numbers.arrays(np.float32, size, elements=st.one_of(usual, edges, far), fill=usual))


def check(rig: LinearRig, found: np.ndarray) -> None:
    controls = rig.lower + torch.from_numpy(found) * (rig.upper - rig.lower)
    controls.requires_grad_()
    vertices = rig(controls)
    assert vertices.shape == (len(controls), *rig.rest_vertices.shape) and vertices.dtype == rig.dtype
    assert torch.isfinite(vertices).all()
    (gradient,) = torch.autograd.grad(vertices.square().mean(), controls)
    assert torch.isfinite(gradient).all()
    with torch.no_grad():
        size = 1 + vertices.abs().amax()
        for row in range(len(controls)):  # a mesh does not depend on those beside it
            assert (rig(controls[row : row + 1])[0] - vertices[row]).abs().max() <= 1e-5 * size
        double = rig(controls.double())
        assert double.dtype == torch.float64 and torch.isfinite(double).all()


@pytest.mark.parametrize("name", RIGS)
def test_meshes_and_gradients_are_finite_for_any_controls(rigs, name):
    explore(rigs[name], QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
def test_meshes_and_gradients_are_finite_for_many_more_controls(rigs, name):
    explore(rigs[name], MANY)


def explore(rig: LinearRig, cases: int) -> None:
    how = settings(max_examples=cases, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    how(given(shares(rig))(lambda found: check(rig, found)))()


@pytest.mark.parametrize("name", RIGS)
def test_a_control_that_is_no_number_spoils_its_own_mesh_alone(rigs, name):
    rig = rigs[name]
    controls = rig.neutral_controls.repeat(3, 1)
    for wrong in (math.nan, math.inf, -math.inf):
        controls[1, 0] = wrong
        with torch.no_grad():
            vertices = rig(controls)
        assert torch.isfinite(vertices[[0, 2]]).all()
        torch.testing.assert_close(vertices[0], vertices[2], rtol=0, atol=1e-4)
