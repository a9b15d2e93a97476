"""Truncated files and flipped bits: found by a checksum, named, and made again where that is possible."""

import random
import shutil
from pathlib import Path

import pytest
import torch

from riginv.errors import InputError
from riginv.inference.bundle import read_bundle
from riginv.runs.cache import cache_folder, cached_tensors
from riginv.runs.checksums import append_checksum, has_valid_checksum
from tests.faults.contents import contents
from tests.faults.tally import fault
from tests.faults.works import QUICK, sampling, training

LAST, BEFORE = "run/checkpoints/last.ckpt", "run/checkpoints/before.ckpt"
NAMED = "truncated or altered since it was written (SHA-256 differs)"


def damage(path: Path, draw: random.Random) -> str:
    """Flip a bit of a file, or cut it short; says which."""
    content = bytearray(path.read_bytes())
    if draw.random() < 0.5:
        place = draw.randrange(len(content))
        content[place] ^= 1 << draw.randrange(8)
        path.write_bytes(content)
        return f"a bit of byte {place} flipped"
    place = draw.randrange(len(content))
    path.write_bytes(content[:place])
    return f"cut to {place} bytes"


def test_flipped_bits_of_a_sealed_file_are_found(tmp_path):
    path = tmp_path / "state.ckpt"
    state = {"weights": torch.arange(300.0), "step": 7}
    torch.save(state, path)
    assert not has_valid_checksum(path)
    append_checksum(path)
    assert has_valid_checksum(path)
    assert torch.load(path, weights_only=True)["weights"].equal(state["weights"])
    with pytest.raises(ValueError, match="not a zip archive without a comment"):
        append_checksum(path)
    whole = path.read_bytes()
    for place in range(0, len(whole), 5):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :])
        assert not has_valid_checksum(path), f"byte {place}"
    for length in range(0, len(whole), 29):
        path.write_bytes(whole[:length])
        assert not has_valid_checksum(path), f"{length} bytes"


SAYS = "truncated or altered|names a file outside|missing from|no bundle there|cannot be read"


@pytest.mark.parametrize("count", [1, pytest.param(30, marks=pytest.mark.slow)])
def test_a_damaged_checkpoint_is_named_and_the_one_before_is_used(commands, whole, tmp_path, count):
    work, draw = training(*QUICK), random.Random(0)
    expected = whole(work).contents
    broken = work.prepare(tmp_path / "broken")
    running = commands.start(work.name, work.arguments, broken)
    while not (broken / BEFORE).exists():
        assert not running.ends_within(0.01), "it ended before it could be killed"
    running.kill()
    running.wait()
    for number in range(count):
        for both in (False, True):
            here = shutil.copytree(broken, tmp_path / f"copy {number} {both}")
            damaged = [name for name in ((LAST, BEFORE) if both else (LAST,)) if (here / name).exists()]
            with fault("damaged checkpoint", "named; the one before it is used, or training starts over", len(damaged)):
                how = [damage(here / name, draw) for name in damaged]
                done = commands.run(work.name, [*work.arguments, *work.again], here)
                assert done.code == 0, f"{how}: {done.said}"
                assert NAMED in done.said and all(name in done.said for name in damaged)
                assert ("training starts over" if both else f"going on from {here / BEFORE}") in done.said
                assert contents(here) == expected, how
            shutil.rmtree(here)


@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_damaged_bundle_is_refused_and_named(commands, trained, tmp_path, count):
    draw, bundle = random.Random(1), trained / "run/bundle"
    for _ in range(count):
        copy = shutil.copytree(bundle, tmp_path / "bundle")
        path = draw.choice(sorted(copy.iterdir()))
        with fault("damaged bundle", "named by its SHA-256; made again from the run's last checkpoint"):
            how = damage(path, draw)
            with pytest.raises(InputError, match=SAYS):
                read_bundle(copy)
                pytest.fail(f"{path.name}: {how}: it was read all the same")
        shutil.rmtree(copy)


@pytest.mark.parametrize("count", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_a_damaged_bundle_of_a_finished_run_is_made_again(commands, whole, tmp_path, count):
    work, draw = training(*QUICK), random.Random(2)
    expected = whole(work).contents
    for number in range(count):
        here = shutil.copytree(whole(work).folder, tmp_path / f"copy {number}")
        path = here / "run/bundle" / draw.choice(("bundle.yaml", "weights.safetensors", "space.safetensors", "SHA256SUMS"))
        with fault("damaged bundle", ""):
            how = damage(path, draw)
            done = commands.run(work.name, [*work.arguments, *work.again], here)
            assert done.code == 0 and "is written again" in done.said, f"{path.name}: {how}: {done.said}"
            assert contents(here) == expected
        shutil.rmtree(here)


@pytest.mark.parametrize("count", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_a_damaged_chunk_of_a_store_is_named_and_made_again(commands, whole, tmp_path, count):
    work, draw = sampling(), random.Random(5)
    expected = whole(work).contents
    for number in range(count):
        here = shutil.copytree(whole(work).folder, tmp_path / f"copy {number}")
        chunks = sorted(path for path in (here / "poses.zarr").rglob("c/*/*") if path.is_file() and path.stat().st_size)
        path = draw.choice(chunks)
        with fault("damaged chunk of a store", "named by its checksum; the same command makes it again"):
            how = f"{path}: {damage(path, draw)}"
            done = commands.run(work.name, ["verify=poses.zarr"], here)
            assert done.code == 1 and "Traceback" not in done.said and " damaged" in done.said, how + done.said
            done = commands.run(work.name, work.arguments, here)
            assert done.code == 0 and contents(here) == expected, how + done.said
        shutil.rmtree(here)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_damaged_tensors_of_the_cache_are_built_again(own_cache, count):
    draw, built = random.Random(3), []

    def build() -> dict[str, torch.Tensor]:
        built.append(1)
        return {"values": torch.arange(50.0), "faces": torch.arange(12).reshape(4, 3), "scale": torch.tensor(0.5)}

    cached_tensors("thing", "key", build)
    (path,) = cache_folder().glob("thing-key*")
    whole = path.read_bytes()
    for _ in range(count):
        with fault("damaged file of the cache", "found by its SHA-256; built again"):
            how, before = damage(path, draw), len(built)
            found = cached_tensors("thing", "key", build)
            assert len(built) == before + 1, how
            assert all(found[name].equal(value) for name, value in build().items())
            assert path.read_bytes() == whole
    assert [inside.name for inside in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["config.yaml", "metrics.json"])
def test_other_damaged_files_of_a_run_are_named_or_made_again(commands, whole, tmp_path, name):
    work = training(*QUICK)
    expected = whole(work).contents
    here, draw = shutil.copytree(whole(work).folder, tmp_path / "copy"), random.Random(4)
    whole = (here / "run" / name).read_bytes()
    with fault(f"damaged {name}", "named" if name == "config.yaml" else "made again from the run's last checkpoint"):
        (here / "run" / name).write_bytes(whole[: draw.randrange(len(whole) // 2)])
        done = commands.run(work.name, [*work.arguments, *work.again], here)
        if name == "config.yaml":
            assert done.code == 1 and f"config.yaml: {NAMED}" in done.said and "Traceback" not in done.said
        else:
            assert done.code == 0 and contents(here) == expected, done.said
