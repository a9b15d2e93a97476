"""Heads for tests: one of blendshapes alone, and one with more joints than an exact basis can have."""

from pathlib import Path

import numpy as np
from scipy import sparse

from riginv.rig.black_box import BlackBoxRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from rigs.dna import DnaRig
from rigs.dna.draft import Draft, Group, Joint, MeshDraft, Row
from rigs.dna.exports.blendshapes import Drive, Factor, Shape, blendshape_draft, triangles
from tests.rigs.dna.files import ball, written


def blendshape_head() -> Draft:
    """A jaw with an in-between and a combination, a two-sided control, a blink."""
    vertices, faces = ball()
    random = np.random.default_rng(0)
    drives = {"jawOpen": Drive("jawOpen"), "mouthSmileLeft": Drive("smiles"), "mouthSmileRight": Drive("smiles", 0.0, -1.0)}
    drives["blink"] = Drive("blink")
    factors = {name: Factor(name, name) for name in drives}
    factors["jawOpen50"] = Factor("jawOpen50", "jawOpen", (0.0, 0.5, 1.0))
    members = {name: [factor] for name, factor in factors.items()}
    members["jawOpen_smiles"] = [factors["jawOpen"], factors["mouthSmileLeft"]]
    order = ["jawOpen", "jawOpen50", "jawOpen_smiles", "mouthSmileLeft", "mouthSmileRight", "blink"]
    shapes = [Shape(name, members[name], random.normal(size=vertices.shape)) for name in order]
    return blendshape_draft("head", vertices, triangles(faces), drives, shapes)


def many_joints(count: int = 40) -> Draft:
    """A ball of 642 vertices with joints all over, three controls each, and a few channels."""
    vertices, faces = ball(3)
    random = np.random.default_rng(0)
    found = Draft("many", gui=[f"g{number}" for number in range(6)], raw=[f"g{number}" for number in range(6)])
    found.rows = [Row.between(name, name, (0, 0), (1, 1)) for name in found.gui]
    found.psds = [(0, 1), (2, 3)]
    points = vertices[random.choice(len(vertices), count, replace=False)]
    found.joints = [Joint("root", -1, (0, 1500, 0))]
    found.joints += [Joint(f"j{number}", 0, point - [0, 1500, 0]) for number, point in enumerate(points)]
    for joint in range(1, count + 1):
        columns = sorted(random.choice(8, 3, replace=False).tolist())
        found.groups.append(Group(columns, 9 * joint + np.arange(6), random.normal(size=(6, 3)) * 4))
    found.channels = [(f"c{number}", number) for number in range(8)]
    away = np.linalg.norm(vertices[:, None] - points, axis=2)
    weights = np.exp(-0.5 * (away / 20) ** 2)
    weights[weights < 0.02] = 0
    weights = np.concatenate([np.full((len(vertices), 1), 0.05), weights], axis=1)
    skin = sparse.csr_array(weights / weights.sum(axis=1, keepdims=True))
    deltas = {number: random.normal(size=3) * np.exp(-away[:, number : number + 1] / 20) for number in range(8)}
    found.meshes = [MeshDraft("skin", vertices, triangles(faces), skin, deltas)]
    return found


def many_joints_fitted(path: Path) -> RigInMeshSpace:
    """The head `many_joints`, written to a file, with a basis fitted to its poses."""
    rig = BlackBoxRig.sampled(DnaRig(str(written(path, many_joints().file()))), samples=150, residual_mm=0.05)
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))
