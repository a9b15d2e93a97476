"""Every file that riginv reads, whole, with what reads it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh

from riginv.clips.bvh import read_bvh
from riginv.clips.clip import Clip
from riginv.clips.open import open_sequence
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units
from riginv.rig.pairs import read_pairs, write_pairs
from rigs.gltf import GltfRig
from rigs.shapes import ShapesRig
from tests.fuzz import characters, surfaces
from tests.fuzz.own_files import (
    Make,
    _bundle,
    _cache,
    _checkpoint,
    _configs,
    _files,
    _kept_methods,
    _kept_step,
    _masks,
    _picked,
    _regions,
    _results,
    _run_folder,
    _step_tensors,
    toy,
)
from tests.fuzz.tally import Target
from tests.support import sculpts
from tests.support.clips import (
    performance,
    reading_options,
    write_animated_glb,
    write_mdd,
    write_npz,
    write_obj,
    write_pc2,
    write_skinned_usd,
    write_usd,
)


def read_clip(path: Path) -> np.ndarray:
    """As the command does: opened, compared with the rig, measured, and read window by window."""
    rig = toy()
    sequence = open_sequence(str(path), rig, reading_options())
    check_topology(sequence, rig)
    clip = Clip(sequence, resolve_units(sequence, rig, reading_options()))
    batches = [clip.vertices(start, min(start + 5, len(clip))).numpy() for start in range(0, len(clip), 5)]
    found = np.concatenate(batches)
    assert found.shape[1:] == (len(rig.rest_vertices), 3) and found.dtype == np.float32
    return found


def _ply(path: Path, meshes: np.ndarray, faces: np.ndarray, encoding: str) -> Path:
    mesh = trimesh.Trimesh(meshes[0], faces, process=False)
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding=encoding))
    return path


def _npy(path: Path, meshes: np.ndarray) -> Path:
    np.save(path, meshes.astype(np.float32))
    return path


def _curves(path: Path) -> Path:
    names, values = toy().control_names, np.linspace(0, 1, 42).reshape(6, 7).round(3)
    if path.suffix == ".npz":
        np.savez(path, controls=values, names=np.array(names), fps=25.0, frame_numbers=np.arange(6))
    else:
        rows = [",".join(map(str, (row, row / 25, *values[row]))) for row in range(6)]
        path.write_text("\n".join([",".join(["frame", "seconds", *names]), *rows]) + "\n")
    return path


def _take(path: Path) -> Path:
    rows = [f"00:00:0{second}:00.000,61,{second / 10},0.5" for second in range(4)]
    path.write_text("\n".join(["Timecode,BlendShapeCount,JawOpen,MouthFunnel", *rows]) + "\n")
    return path


CLIPS: dict[str, Callable[[Path, np.ndarray, np.ndarray], Path]] = {
    "npz": write_npz,
    "packed.npz": lambda path, meshes, faces: write_npz(path, meshes, faces, compressed=True),
    "npy": lambda path, meshes, faces: _npy(path, meshes),
    "obj": lambda path, meshes, faces: write_obj(path, meshes[0], faces),
    "ply": lambda path, meshes, faces: _ply(path, meshes, faces, "binary"),
    "text.ply": lambda path, meshes, faces: _ply(path, meshes, faces, "ascii"),
    "mdd": lambda path, meshes, faces: write_mdd(path, meshes),
    "pc2": lambda path, meshes, faces: write_pc2(path, meshes),
    "glb": write_animated_glb,
    "csv": lambda path, meshes, faces: _take(path),
    "curves.csv": lambda path, meshes, faces: _curves(path),
    "curves.npz": lambda path, meshes, faces: _curves(path),
    "usda": write_usd,
    "usdc": write_usd,
    **dict.fromkeys(("skinned.usda", "skinned.usdc"), lambda path, meshes, faces: write_skinned_usd(path, toy())),
}


def _clip(kind: str) -> Make:
    def make(folder: Path) -> Target:
        path = CLIPS[kind](folder / f"clip.{kind}", performance(toy(), 7), toy().faces.numpy())
        return Target([path], lambda: read_clip(path))

    return make


def _sequence(folder: Path) -> Target:
    paths = [write_obj(folder / f"shot.{n}.obj", mesh, toy().faces.numpy()) for n, mesh in enumerate(performance(toy(), 3))]
    return Target(paths, lambda: read_clip(folder / "shot.*.obj"))


def _shapes(folder: Path) -> Target:
    sculpts.write_folder(folder, smile=sculpts.offset(1), jaw=sculpts.offset(2), smile50=sculpts.offset(3))
    sculpts.write_ply(folder / "text.ply", sculpts.offset(4), "ascii")
    sculpts.write_ply(folder / "binary.ply", sculpts.offset(5), "binary_little_endian")
    return Target(_files(folder), lambda: ShapesRig(str(folder)))


def _deltas(folder: Path) -> Target:
    from safetensors.numpy import save_file

    sculpts.write_folder(folder)
    np.save(folder / "one.npy", sculpts.offset(1))
    np.savez(folder / "two.npz", a=sculpts.offset(2), b=sculpts.offset(3))
    save_file({"c": sculpts.offset(4)}, folder / "three.safetensors")
    victims = [path for path in _files(folder) if path.suffix != ".obj"]
    return Target(victims, lambda: ShapesRig(str(folder)))


def _bvh(folder: Path) -> Target:
    joint = "{\nOFFSET 0 10 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 5 0\n}\n}\n"
    root = "HIERARCHY\nROOT hips\n{\nOFFSET 0 90 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
    rows = "".join(" ".join(f"{10 * frame + column:.4f}" for column in range(12)) + "\n" for frame in range(4))
    path = folder / "a.bvh"
    path.write_text(f"{root}JOINT neck\n{joint}JOINT tail\n{joint}}}\nMOTION\nFrames: 4\nFrame Time: 0.04\n{rows}")
    return Target([path], lambda: read_bvh(path))


def _avatar(folder: Path) -> Target:
    path = write_animated_glb(folder / "a.glb", performance(toy(), 4), toy().faces.numpy())
    return Target([path], lambda: GltfRig(str(path)))


def _avatar_in_parts(folder: Path) -> Target:
    path = write_animated_glb(folder / "a.gltf", performance(toy(), 4), toy().faces.numpy())
    return Target(_files(folder), lambda: GltfRig(str(path)))


def pair_arrays() -> dict[str, np.ndarray]:
    rig = toy()
    controls = torch.rand(6, 7, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        vertices = rig(controls)
    limits = {name: getattr(rig, name).numpy() for name in ("lower", "upper")}
    arrays = {"controls": controls.numpy(), "vertices": vertices.numpy(), "rest_vertices": rig.rest_vertices.numpy()}
    more = {"faces": rig.faces.numpy(), "control_names": np.array(rig.control_names), "neutral": rig.neutral_controls.numpy()}
    return {**arrays, **more, **limits}


def _pairs_npz(folder: Path) -> Target:
    write_pairs(folder / "p.npz", pair_arrays())
    return Target([folder / "p.npz"], lambda: read_pairs(folder / "p.npz"))


def _pairs_npy(folder: Path) -> Target:
    for name, array in pair_arrays().items():
        np.save(folder / f"{name}.npy", array)
    return Target(_files(folder), lambda: read_pairs(folder))


def _pairs_zarr(folder: Path) -> Target:
    write_pairs(folder / "p.zarr", pair_arrays())
    return Target(_files(folder / "p.zarr"), lambda: read_pairs(folder / "p.zarr"))


READERS: dict[str, Make] = {
    **{f"clip .{kind}": _clip(kind) for kind in CLIPS},
    "clip .bvh": _bvh,
    "clip sequence": _sequence,
    "rig shapes": _shapes,
    "rig deltas": _deltas,
    "rig .glb": _avatar,
    "rig .gltf": _avatar_in_parts,
    "rig .dna": characters.dna(8),
    "rig .dna 2.1": characters.dna(1),
    "rig .dna, numbers": characters.dna_numbers,
    "pairs .npz": _pairs_npz,
    "pairs .npy": _pairs_npy,
    "pairs .zarr": _pairs_zarr,
    "bundle": _bundle(signed=False),
    "bundle, signed": _bundle(signed=True),
    "checkpoint": _checkpoint,
    "run folder": _run_folder,
    "results": _results,
    "kept methods": _kept_methods,
    "kept steps": _kept_step,
    "step tensors": _step_tensors,
    "cache": _cache,
    "control masks": _masks,
    "vertex regions": _regions,
    "vertex numbers": _picked,
    "config folder": _configs,
    "ragged scans": surfaces.ragged,
    **{f"folder of scans, {kind}": surfaces.stills(kind) for kind in ("stl", "stl_ascii", "ply", "obj", "glb")},
    **{f"scans {suffix}": surfaces.stage(suffix) for suffix in (".usda", ".usdc")},
    "scans .abc": surfaces.archive,
    "landmarks": surfaces.landmarks,
    **{f"landmarks {suffix}": surfaces.landmark_take(suffix) for suffix in (".trc", ".c3d")},
    "prior": surfaces.prior,
    **{f"markers {suffix}": surfaces.markers(suffix) for suffix in surfaces.WRITERS},
    "marker map": surfaces.marker_map,
}
IN_PROCESSES = (
    "clip .usda",
    "clip .usdc",
    "clip .skinned.usda",
    "clip .skinned.usdc",
    "scans .usda",
    "scans .usdc",
    "scans .abc",
)  # a case costs a process or three
