"""Stores of poses: what other programs read there, and what is missing or damaged."""

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch
import zarr
from filelock import FileLock

from riginv.errors import InputError
from riginv.sampling.store.checking import examine
from riginv.sampling.store.filling import Shard, fill
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.summary import finish
from riginv.sampling.store.training import finished_store
from tests.sampling.store.support import PLAN, SPARSE, arrays, filled, flip, plan, same
from tests.support.toys import BlackBox, ToyRig


class NotANumber(ToyRig):
    """Gives NaN where its first control is above a half."""

    def coefficients(self, controls):
        found = super().coefficients(controls)
        return torch.where(controls[:, :1] > 0.5, torch.nan, found) if len(controls) > 1 else found


def test_other_programs_read_what_the_rig_says(whole):
    group, rig = zarr.open_group(whole, mode="r"), ToyRig()
    controls = torch.from_numpy(group["controls"][:])
    assert group.metadata.zarr_format == 3 and group["controls"].metadata.dimension_names == ("pose", "control")
    torch.testing.assert_close(torch.from_numpy(group["coefficients"][:]), rig.coefficients(controls))
    assert len(controls) == 250 and len(controls.unique(dim=0)) == 250
    facts = dict(group.attrs)
    assert facts["finished"] is True and facts["riginv"]["seed"] == 3
    assert [control["name"] for control in facts["riginv"]["rig"]["controls"]] == list(rig.control_names)
    assert facts["riginv"]["rig"]["controls"][5]["lower"] == -1
    for number, name in enumerate(rig.control_names):
        ends = [float(controls[:, number].min()), float(controls[:, number].max())]
        assert facts["range_seen"][name] == ends


@pytest.mark.parametrize("shards", [["0/2", "1/2"], ["2/3", "0/3", "1/3"]])
def test_the_result_does_not_depend_on_shards(whole, tmp_path, shards):
    for number, shard in enumerate(shards):
        assert (fill(plan({**PLAN, "out": str(tmp_path / "s.zarr"), "shard": shard})).absent == 0) == (
            number == len(shards) - 1
        )
    assert same(whole, tmp_path / "s.zarr")


@pytest.mark.slow
def test_the_result_does_not_depend_on_jobs(whole, tmp_path):
    filled(tmp_path / "two.zarr", jobs=2)
    assert same(whole, tmp_path / "two.zarr")


@pytest.mark.parametrize("text", ["", "2/2", "-1/2", "1", "a/b", "1/0", None])
def test_a_shard_is_i_of_n(text):
    with pytest.raises(InputError, match="expected i/n"):
        Shard.parse(text)


def break_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [break_off, flip, empty, Path.unlink])
@pytest.mark.parametrize("name", ["controls", "coefficients", "control_range", "errors", "ledger"])
def test_damage_is_named_and_made_good(whole, copy, damage, name):
    damage(next(path for path in (copy / name / "c/3").rglob("*") if path.is_file()))
    found = examine(PoseStore.find(StoreLocation(str(copy))))
    assert found.incomplete == [3]
    assert (name, damage) == ("ledger", Path.unlink) or f"chunk 3 of '{name}'" in found.damaged[3]
    assert fill(plan({**PLAN, "out": str(copy)})).made == 20
    assert same(whole, copy) and examine(PoseStore.find(StoreLocation(str(copy)))).complete


@pytest.mark.parametrize("damage", [flip, Path.unlink])
def test_damage_in_other_shards_is_named_at_the_end(copy, damage):
    damage(copy / "control_range/c/3/0/0")
    with pytest.raises(InputError, match="'control_range' is .*again, which makes it anew, for all shards"):
        finish(PoseStore.find(StoreLocation(str(copy))))


def test_a_chunk_in_the_place_of_another_is_noticed(copy):
    shutil.copy(copy / "coefficients/c/4/0", copy / "coefficients/c/5/0")
    assert list(examine(PoseStore.find(StoreLocation(str(copy)))).damaged) == [5]


def alter(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"20", b"25").replace(b"13", b"12"))  # sizes


@pytest.mark.parametrize("damage", [break_off, alter, empty])
@pytest.mark.parametrize("name", ["zarr.json", "controls/zarr.json", "ledger/zarr.json"])
def test_damaged_descriptions_are_named(copy, damage, name):
    damage(copy / name)
    with pytest.raises(InputError, match="another store|no store of riginv") as error:
        finished_store(str(copy))
    assert str(copy) in str(error.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 4}, "seed was 3, now 4"),
        ({"samples": 300}, "samples was 250, now 300"),
        ({"dtype": "float16"}, "dtype was 'float32'"),
        ({"sampler": {**SPARSE, "controls": {**SPARSE["controls"], "max_active": 3}}}, "max_active was None, now 3"),
        ({"rig": {"_target_": "tests.support.toys.ToyRig", "last_name": "other"}}, "instead of"),
        ({"rig": {"_target_": "tests.support.toys.ToyRig", "detail": 3}}, "642 vertices instead of 162"),
        ({"rig": {"_target_": "tests.sampling.store.test_store.Louder"}}, "makes other meshes"),
    ],
)
def test_a_store_of_something_else_is_refused_before_any_work(copy, change, said):
    before = {path: path.stat().st_mtime_ns for path in copy.rglob("*")}
    with pytest.raises(InputError, match=said):
        filled(copy, **change)
    assert before == {path: path.stat().st_mtime_ns for path in copy.rglob("*")}


class Louder(ToyRig):
    """Like the toy, but for one control that does a little more."""

    def coefficients(self, controls):
        return super().coefficients(controls * torch.tensor([1.0, 1, 1, 1.01, 1, 1, 1]))


def test_another_format_is_refused(copy):
    content = json.loads((copy / "zarr.json").read_text())
    content["attributes"]["riginv"]["format"] = 2
    (copy / "zarr.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="format 2, and this riginv has format 1"):
        filled(copy)


def test_a_folder_of_other_things_is_left_alone(tmp_path):
    (tmp_path / "s.zarr").mkdir()
    (tmp_path / "s.zarr/notes.txt").write_text("mine")
    with pytest.raises(InputError, match="no store of riginv"):
        filled(tmp_path / "s.zarr")
    zarr.open_group(tmp_path / "other.zarr", mode="w", attributes={"mine": 1})
    with pytest.raises(InputError, match="no store of riginv"):
        filled(tmp_path / "other.zarr")


def test_of_two_that_write_one_shard_one_refuses(tmp_path):
    filled(tmp_path / "s.zarr", shard="1/2")
    with FileLock(tmp_path / ".s.zarr.shard-0-of-2.lock"):
        with pytest.raises(InputError, match="another process is sampling shard 0/2"):
            filled(tmp_path / "s.zarr", shard="0/2")
    assert fill(plan({**PLAN, "out": str(tmp_path / "s.zarr"), "shard": "0/2"})).absent == 0
    assert [path.name for path in tmp_path.iterdir()] == ["s.zarr"]


def test_a_read_only_folder_is_one_sentence():
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        closed = Path(folder, "closed")
        filled(closed / "begun.zarr", shard="0/2")
        closed.chmod(0o555)
        root = os.geteuid() == 0  # who may write anywhere
        if root:
            os.seteuid(65534)
        try:
            if not os.access(sys.prefix, os.R_OK | os.X_OK, effective_ids=True):
                pytest.skip("the environment of Python is closed to all but root")
            for name in ("begun.zarr", "new.zarr"):
                with pytest.raises(InputError, match="cannot be written: Permission denied"):
                    filled(closed / name)
        finally:
            if root:
                os.seteuid(0)
            closed.chmod(0o755)


def test_nan_names_the_pose(tmp_path):
    with pytest.raises(InputError, match="NaN or infinite values at pose") as error:
        filled(tmp_path / "s.zarr", rig={"_target_": "tests.sampling.store.test_store.NotANumber"})
    (file,) = tmp_path.glob("*.json")
    controls = json.loads(file.read_text())
    assert str(file) in str(error.value) and controls["bump0"] > 0.5 and list(controls) == list(ToyRig().control_names)


def test_float16_says_what_it_costs(whole, tmp_path):
    store = filled(tmp_path / "half.zarr", dtype="float16", vertices=True)
    finish(store)
    half, exact, rig = arrays(tmp_path / "half.zarr"), arrays(whole), ToyRig()
    assert half["coefficients"].dtype == np.float16 and np.array_equal(half["controls"], exact["controls"])
    said = zarr.open_group(tmp_path / "half.zarr", mode="r").attrs["errors"]
    apart = np.abs(half["coefficients"].astype(float) - exact["coefficients"])
    assert said["coefficient_greatest"] == pytest.approx(apart.max(), rel=1e-4) and apart.max() > 0
    assert said["coefficient_mean"] == pytest.approx(apart.mean(), rel=1e-4)
    apart = np.linalg.norm(half["vertices"].astype(float) - rig(torch.from_numpy(exact["controls"])).numpy(), axis=2)
    assert said["vertices_greatest_mm"] == pytest.approx(apart.max(), rel=1e-3)
    assert said["vertices_mean_mm"] == pytest.approx(apart.mean(), rel=1e-3)
    moved = np.linalg.norm(
        np.tensordot(half["coefficients"].astype(float) - exact["coefficients"], rig.basis.numpy(), 1), axis=2
    )
    assert 0 < said["mesh_mean_mm"] == pytest.approx(moved.mean(), rel=0.2)


def test_a_black_box_is_stored_in_a_basis_of_its_own(tmp_path):
    black = {"rig": {"_target_": "tests.support.toys.BlackBox"}, "samples": 60}
    store = filled(tmp_path / "b.zarr", **black)
    half = fill(plan({**PLAN, **black, "out": str(tmp_path / "c.zarr"), "shard": "1/2"}))
    assert half.absent == 2 and fill(plan({**PLAN, **black, "out": str(tmp_path / "c.zarr"), "shard": "0/2"})).absent == 0
    assert same(tmp_path / "b.zarr", tmp_path / "c.zarr")
    read, rig = arrays(tmp_path / "b.zarr"), BlackBox()
    meshes = rig.rest_vertices.numpy() + np.tensordot(read["coefficients"], read["basis"], 1)
    apart = meshes - rig(torch.from_numpy(read["controls"])).numpy()
    assert np.linalg.norm(apart, axis=2).mean() < 0.02
    finish(store)
    said = zarr.open_group(tmp_path / "b.zarr", mode="r").attrs["errors"]["outside_mean_mm"]
    assert said == pytest.approx(np.sqrt((apart**2).sum(axis=2).mean()), rel=1e-2)


@pytest.mark.parametrize("form", ["memory://{}/s.zarr", "file://{}/s.zarr"])
def test_urls_are_places_too(whole, tmp_path, form):
    url = form.format(tmp_path)
    filled(url, shard="0/2")
    filled(url, shard="1/2")
    store = PoseStore.find(StoreLocation(url))
    assert examine(store).complete
    for name, values in arrays(whole).items():
        np.testing.assert_array_equal(store.arrays[name][:], values)
    with pytest.raises(InputError, match="seed was 3"):
        filled(url, seed=5)


def test_an_unknown_url_is_refused():
    with pytest.raises(InputError, match="nowhere://x: cannot be reached"):
        filled("nowhere://x")
