"""Reading stores: the order of poses, damage, and training on them."""

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.sampling.controls import PlausibleControls, SparseControls
from riginv.sampling.meshes import Mixture, RandomCombinations, RigPoses
from riginv.sampling.store.layout import Layout
from riginv.sampling.store.training import StoreSampler, finished_store
from riginv.sampling.store.windows import WindowOrder, WindowReader
from tests.sampling.store.support import filled, flip
from tests.support.toys import ToyRig


def test_an_epoch_holds_every_pose_once_and_no_two_are_alike():
    layout = Layout(1003, 20, "float32", 7, 12)
    order = WindowOrder(layout, seed=1)
    order.chunks = 6
    epochs = []
    for epoch in range(2):
        seen = []
        for position in range(epoch * 1003, (epoch + 1) * 1003):
            where, place = order.find(position)
            chunks = order.windows(epoch)[0][where[1]]
            poses = torch.cat([torch.arange(1003)[layout.rows(chunk)] for chunk in chunks])
            seen.append(int(poses[order.rows(where, len(poses))[place]]))
        assert sorted(seen) == list(range(1003)) and where[0] == epoch
        epochs.append(seen)
    assert epochs[0] != epochs[1]
    neighbours = np.abs(np.diff(epochs[0]))
    assert np.median(neighbours) > 100  # of a sorted list 1, of a perfect shuffle about 290


def test_reading_is_the_same_from_any_start(whole):
    store = finished_store(str(whole))

    def reader() -> WindowReader:
        made = WindowReader(store, seed=0)
        made.order.chunks = 4
        return made

    straight, jumping = reader(), reader()
    batches = [straight.poses(step * 32, 32)["controls"] for step in range(30)]
    for step in (29, 3, 17, 16, 0):
        assert torch.equal(jumping.poses(step * 32, 32)["controls"], batches[step])
    assert len(straight._window["controls"]) <= 80  # four chunks of twenty


def test_reading_names_damage(copy):
    flip(copy / "coefficients/c/7/0")
    sampler = WindowReader(finished_store(str(copy)), seed=0)
    with pytest.raises(InputError, match="chunk 7 of 'coefficients' is damaged"):
        for start in range(0, 250, 25):
            sampler.poses(start, 25)


def test_stored_poses_are_those_of_the_rig(whole, tmp_path, toy):
    batch = StoreSampler(toy, str(whole), seed=0).sample(64, torch.Generator())
    torch.testing.assert_close(batch["coordinates"], toy(batch["controls"]))
    filled(tmp_path / "half.zarr", dtype="float16")
    halved = StoreSampler(toy, str(tmp_path / "half.zarr"), seed=0).sample(64, torch.Generator())
    assert halved["coefficients"].dtype == torch.float32 and torch.equal(halved["controls"], batch["controls"])
    torch.testing.assert_close(halved["coordinates"], batch["coordinates"], atol=0.05, rtol=0)


def test_stored_poses_take_the_share_of_those_that_ask_the_rig(whole, toy):
    parts = {"drawn": RandomCombinations(toy), "sparse": RigPoses(toy, SparseControls(toy))}
    parts["plausible"] = RigPoses(toy, PlausibleControls(toy))
    stored = StoreSampler(toy, str(whole), seed=0)
    mixed = Mixture(toy, parts, {"drawn": 2, "sparse": 1, "plausible": 1}).reading(stored)
    assert mixed.fractions == {"drawn": 0.5, "stored": 0.5}
    mixed.at_step(3)
    batch = mixed.sample(64, torch.Generator())
    expected = stored.reader.poses(3 * 32, 32)
    torch.testing.assert_close(batch["coordinates"][32:], toy.coordinates_of(expected["coefficients"]))


def test_training_refuses_other_and_unfinished_stores(whole, tmp_path, toy):
    rig: LinearRig = ToyRig(last_name="other")
    with pytest.raises(InputError, match="was made with rig 'toy'"):
        StoreSampler(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), str(whole), 0)
    filled(tmp_path / "s.zarr", shard="0/2")
    with pytest.raises(InputError, match="not finished: 6 of its 13 chunks are absent"):
        StoreSampler(toy, str(tmp_path / "s.zarr"), 0)
    with pytest.raises(InputError, match="no store of poses"):
        StoreSampler(toy, str(tmp_path / "none.zarr"), 0)
