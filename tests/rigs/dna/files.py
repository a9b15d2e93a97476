"""Small DNA files of the project's own, with everything in them that the format has."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import sparse

from rigs.dna.draft import Draft, Group, Joint, MeshDraft, Row
from rigs.dna.format import DnaFile, Layer, write_dna
from rigs.dna.format.later_layers import (
    Conventions,
    JointRepresentations,
    MachineLearning,
    MachineLearningOperations,
    Net,
    NetLayer,
    Operation,
    OperationSets,
    Pose,
    PoseOutput,
    RadialBasis,
    RadialBasisOutputs,
    Representation,
    Solver,
    Twist,
    TwistsAndSwings,
)
from rigs.dna.format.layers import AnimatedMaps, Behavior, Conditions, Definition, Descriptor, Lods, RotationSigns
from rigs.dna.format.ragged import Ragged
from tests.conftest import ROOT

RAWS, PSDS, MLS, RBFS = 12, 3, 2, 3
QUATERNION = (8, 9, 10, 11)  # raw controls
FIRST_ML, FIRST_RBF = RAWS + PSDS, RAWS + PSDS + MLS
SHARED = Path(os.environ.get("RIGINV_SHARED", ROOT.parent / "shared"))


def shared(*parts: str) -> Path:
    """A file of the read-only material; the test is skipped where it is absent."""
    path = SHARED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"the shared material is not here: {path}")
    return path


def floats(*values) -> np.ndarray:
    return np.array(values, dtype=np.float32).reshape(-1)


def shorts(*values) -> np.ndarray:
    return np.array(values, dtype=np.uint16).reshape(-1)


def ball(detail: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A sphere around (0, 1600, 0) mm: vertices and triangles."""
    sphere = trimesh.creation.icosphere(detail, radius=80.0)
    return np.array(sphere.vertices) + np.array([0, 1600, 0]), np.array(sphere.faces)


def draft(seed: int = 0) -> Draft:
    """A character with GUI and raw controls, PSDs, joints and channels, by random numbers."""
    random = np.random.default_rng(seed)
    vertices, faces = ball()
    found = Draft("tiny", notes={"note": "Zoë", "seed": str(seed)})
    found.gui = ["g0", "g1", "g2", "g3", "idle"]
    found.raw = [*(f"r{number}" for number in range(8)), "drv.qx", "drv.qy", "drv.qz", "drv.qw"]
    found.rows = [
        *(Row.between("g0", "r0", (0, 0), (0.5, 0.3)), Row.between("g0", "r0", (0.5, 0.3), (1, 1))),
        *(Row.between("g1", "r1", (0, 0), (1, 1)), Row.between("g1", "r2", (-1, 1), (0, 0))),
        *(Row.between("g2", "r3", (0, 0), (0.4, 1)), Row.between("g2", "r3", (0.4, 1), (1, 0))),
        *(Row.between("g2", "r4", (0, 0), (1, 1)), Row.between("g3", "r4", (0, 0), (1, 0.5))),
        *(Row.between("g3", "r5", (0, 0), (1, 1)), Row.between("g3", "r6", (0, 0), (1, 0.8))),
    ]
    found.psds = [(0, 1), (1, 3, 4), (0, 5)]
    found.joints = [
        *(Joint("root", -1, (0, 1500, 0)), Joint("neck", 0, (0, 60, -10), (5, -10, 3)), Joint("head", 1, (0, 40, 10))),
        *(Joint("jaw", 2, (0, -20, 40), (20, 0, 0)), Joint("left", 2, (30, 10, 60)), Joint("right", 2, (-30, 10, 60))),
    ]
    found.groups = [
        Group((0, 1, 3, RAWS), [27, 28, 29, 30, 31, 32, 33, 34, 35], _values(random, 9, 4)),
        Group((1, 2, 4, 5, RAWS + 1), [36, 37, 38, 39, 40, 41, 45, 46, 47, 48, 49, 50], _values(random, 12, 5)),
    ]
    found.channels = [(f"c{number}", number) for number in range(8)] + [(f"p{number}", RAWS + number) for number in range(3)]
    weights = random.random((len(vertices), 6)) ** 3 * (random.random((len(vertices), 6)) < 0.6)
    weights[:, 2] += 0.1
    deltas = {number: _bump(random, vertices) for number in range(len(found.channels))}
    polygons = Ragged(faces.reshape(-1), np.full(len(faces), 3))
    skin = sparse.csr_array(weights / weights.sum(axis=1, keepdims=True))
    coarse, triangles = ball(0)
    found.meshes = [
        MeshDraft("skin", vertices, polygons, skin, deltas),
        MeshDraft("teeth", vertices * [0.4, 1, 0.4] + [0, -20, 0], polygons, None, {0: _bump(random, vertices)}),
        MeshDraft("coarse", coarse, Ragged(triangles.reshape(-1), np.full(len(triangles), 3)), skin[: len(coarse)], {}),
    ]
    return found


def _values(random: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """Millimetres, degrees, and scales, three rows each."""
    sizes = np.resize(np.repeat([6.0, 12.0, 0.05], 3), rows) if rows % 9 == 0 else np.resize(np.repeat([6.0, 12.0], 3), rows)
    return random.normal(size=(rows, columns)) * sizes[:, None]


def _bump(random: np.random.Generator, vertices: np.ndarray) -> np.ndarray:
    near = np.exp(-0.5 * (np.linalg.norm(vertices - vertices[random.integers(len(vertices))], axis=1) / 30) ** 2)
    return near[:, None] * random.normal(size=3) * 5


def two_levels(file: DnaFile) -> DnaFile:
    """The file with a second level of detail: the coarse mesh, fewer rows and channels."""
    contents = {type(layer.content): layer.content for layer in file.layers}
    levels = Lods(shorts(0, 1), (shorts(0, 1), shorts(2)))
    definition = dataclasses.replace(contents[Definition], lod_meshes=levels, maps=("m0", "m1"))
    behavior: Behavior = contents[Behavior]
    groups = tuple(dataclasses.replace(group, row_counts=shorts(len(group.outputs), 6)) for group in behavior.joints.groups)
    table = Conditions(
        shorts(0, 1, 12), shorts(0, 1, 1), floats(0, 0, 0), floats(1, 1, 1), floats(1, 0.5, 0.7), floats(0, 0, 0.1)
    )
    behavior = dataclasses.replace(
        behavior,
        joints=dataclasses.replace(behavior.joints, groups=groups),
        channels=dataclasses.replace(behavior.channels, counts=shorts(11, 4)),
        maps=AnimatedMaps(shorts(3, 1), table),
    )
    descriptor = dataclasses.replace(contents[Descriptor], lod_count=2)
    contents |= {Definition: definition, Behavior: behavior, Descriptor: descriptor}
    return dataclasses.replace(file, layers=tuple(Layer.of(content) for content in contents.values()))


def everything(seed: int = 0, operations: bool = False) -> DnaFile:
    """A file of version 2.8 with every layer, and one that no reader knows."""
    random = np.random.default_rng(seed)
    file = two_levels(draft(seed).file())
    contents = {type(layer.content): layer.content for layer in file.layers}
    behavior = contents[Behavior]
    learned_column = dataclasses.replace(
        behavior.joints.groups[0],
        inputs=shorts(FIRST_ML, FIRST_ML + 1, FIRST_RBF, FIRST_RBF + 1, FIRST_RBF + 2),
        outputs=shorts(*range(9, 15)),
        values=floats(random.normal(size=30) * 0.5),
        row_counts=shorts(6, 3),
        joints=shorts(1),
    )
    groups = (*behavior.joints.groups, learned_column)
    joints = dataclasses.replace(behavior.joints, groups=groups, control_count=RAWS + PSDS + MLS + RBFS)
    more = [
        _learned(random),
        _radial(),
        RadialBasisOutputs(tuple(f"b{number}" for number in range(RBFS)), _outputs()),
        JointRepresentations(tuple(Representation(0, int(joint in (3, 4)), 0) for joint in range(6))),
        TwistsAndSwings(
            twists=(Twist(floats(0.25), shorts(0), shorts(*QUATERNION), 0),),
            swings=(Twist(floats(0.6), shorts(5), shorts(*QUATERNION), 0),),
        ),
        _operations() if operations else MachineLearningOperations((), shorts(), shorts(), shorts(), shorts()),
        Conventions(2, RotationSigns(1, 0xFFFFFFFF, 1), 1),
    ]
    base = [contents[Descriptor], contents[Definition], dataclasses.replace(behavior, joints=joints), file.layers[3].content]
    layers = [Layer.of(content) for content in [*base, *more]]
    return dataclasses.replace(file, version=8, layers=(*layers, Layer("zzz9", (3, 7), b"kept as it is")))


def _learned(random: np.random.Generator) -> MachineLearning:
    def net(inputs: tuple, output: int, activation: int) -> Net:
        size = len(inputs)
        hidden = NetLayer(floats(random.normal(size=3) * 0.1), floats(random.normal(size=3 * size)), activation, floats(0.2))
        return Net(shorts(output), shorts(*inputs), (hidden, NetLayer(floats(0.0), floats(random.normal(size=3)), 4, floats())))

    nets = (net((0, 1, 2), FIRST_ML, 2), net((3, 4), FIRST_ML + 1, 3))
    lods = Lods(shorts(0, 1), (shorts(0, 1), shorts(0)))
    return MachineLearning(
        ("ml0", "ml1"), lods, (("face", "chin"), ("all",), ()), ((shorts(0), shorts(1)), (shorts(),), ()), nets
    )


def _radial() -> RadialBasis:
    half = np.sqrt(0.5)
    quaternions = floats(0, 0, 0, 1, half, 0, 0, half, 0, half, 0, half)
    solvers = (
        Solver("aim", shorts(*QUATERNION), shorts(0, 1, 2), quaternions, 80.0, 0.01, 0, 1, 1, 1, 0, 0),
        Solver("flat", shorts(0, 1), shorts(3, 4), floats(0, 0, 1, 1), 0.0, 0.0, 1, 0, 0, 0, 3, 0),
    )
    lods = Lods(shorts(0, 1), (shorts(0, 1), shorts(1)))
    poses = tuple(Pose(f"pose {number}", scale) for number, scale in enumerate((1.0, 1.0, 0.8, 1.0, 0.5)))
    return RadialBasis(lods, solvers, poses)


def _outputs() -> tuple[PoseOutput, ...]:
    nothing = PoseOutput(shorts(), shorts(), floats())
    one = [PoseOutput(shorts(), shorts(FIRST_RBF + number), floats(1.0)) for number in range(2)]
    return (nothing, *one, nothing, PoseOutput(shorts(5), shorts(FIRST_RBF + 2), floats(0.7)))


def _operations() -> MachineLearningOperations:
    def step(kind: int, parameters: list, *sources: tuple[int, int]) -> Operation:
        sets, steps = ([source[part] for source in sources] for part in (0, 1))
        return Operation(np.array(parameters, dtype=np.uint32), shorts(*sets), shorts(*steps), kind)

    weights = np.array([0.25, 0.75], dtype=np.float32).view(np.uint32).tolist()
    sets = (
        (step(1, [0, 1, 2]), step(1, [3, 4])),
        (step(3, [0], (0, 0)), step(3, [1], (0, 1))),
        (step(4, [1, *weights], (1, 0), (1, 1)),),
        (step(2, [FIRST_ML], (2, 0)), step(2, [FIRST_ML + 1], (1, 1))),
    )
    lods = tuple(Lods(shorts(0, 0), (shorts(*range(len(one))),)) for one in sets)
    return MachineLearningOperations((OperationSets(lods, sets),), shorts(), shorts(), shorts(), shorts())


def written(path: Path, file: DnaFile) -> str:
    """The path, after the file has been written there."""
    write_dna(path, file)
    return str(path)


def changed(file: DnaFile, kind: type, **fields) -> DnaFile:
    """The file with other fields in one of its layers."""
    layers = [
        Layer.of(dataclasses.replace(layer.content, **fields)) if isinstance(layer.content, kind) else layer
        for layer in file.layers
    ]
    return dataclasses.replace(file, layers=tuple(layers))
