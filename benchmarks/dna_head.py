"""A head of production size in a DNA file, made of random numbers: how long it takes to read, and poses a second.

python -m benchmarks.dna_head [--out head.dna] [--joints 800] ...
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from scipy import sparse
from scipy.spatial import cKDTree

from rigs.dna import DnaRig
from rigs.dna.draft import Draft, Group, Joint, MeshDraft, Row
from rigs.dna.format import read_dna, write_dna
from rigs.dna.format.ragged import Ragged

SIZE_MM = np.array([75.0, 110.0, 95.0])  # half axes of the head
CENTRE_MM = np.array([0.0, 1600.0, 0.0])
REACH_MM = 30.0  # how far a control moves skin, one standard deviation
CARRIED = ("root", "neck", "head", "jaw")


def head_shape(rows: int, columns: int) -> tuple[np.ndarray, Ragged]:
    """An ellipsoid of rows times columns vertices, mm, and its quads, open at both poles."""
    up = np.linspace(0.03, np.pi - 0.03, rows)[:, None]
    around = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    unit = np.stack(np.broadcast_arrays(np.sin(up) * np.sin(around), np.cos(up), np.sin(up) * np.cos(around)), axis=2)
    number = np.arange(rows * columns).reshape(rows, columns)
    after = np.roll(number, -1, axis=1)
    quads = np.stack([number[:-1], number[1:], after[1:], after[:-1]], axis=2).reshape(-1)
    return unit.reshape(-1, 3) * SIZE_MM + CENTRE_MM, Ragged(quads, np.full(len(quads) // 4, 4))


def make_head(raws: int, psds: int, joints: int, channels: int, rows: int, columns: int, seed: int = 0) -> Draft:
    """A head whose controls each move the joints and the skin around a centre, and whose PSDs correct neighbours."""
    random = np.random.default_rng(seed)
    vertices, quads = head_shape(rows, columns)
    front = np.flatnonzero(vertices[:, 2] > 0.2 * SIZE_MM[2])
    draft = Draft("production head", sequence="xyz", notes={"made by": "random numbers"})
    centres = vertices[random.choice(front, raws)]
    draft.raw = [f"raw_{number:03d}" for number in range(raws)]
    _add_gui(draft, random)
    pairs = cKDTree(centres).query(centres, k=min(12, raws))[1]
    members: dict[tuple[int, ...], None] = {}
    while len(members) < psds:
        first = int(random.integers(raws))
        others = random.choice(pairs[first, 1:], size=int(random.integers(1, 3)), replace=False)
        members[tuple(sorted({first, *map(int, others)}))] = None
    draft.psds = list(members)
    centres = np.concatenate([centres, [centres[list(group)].mean(axis=0) for group in draft.psds]])
    _add_joints(draft, random, vertices, front, joints, centres)
    chosen = np.concatenate([np.arange(raws), raws + random.choice(psds, channels - raws, replace=False)])
    draft.channels = [(f"channel_{number:03d}", int(control)) for number, control in enumerate(chosen)]
    deltas = {}
    for number, control in enumerate(chosen):
        near = np.exp(-0.5 * (np.linalg.norm(vertices - centres[control], axis=1) / (0.35 * REACH_MM)) ** 2)
        near[near < 0.02] = 0
        displacement = random.normal(size=3) * (1.5 if control < raws else 0.6)
        deltas[number] = near[:, None] * (displacement + random.normal(size=vertices.shape) * 0.05)
    draft.meshes = [MeshDraft("head", vertices, quads, _skin(draft, vertices), deltas)]
    return draft


def _add_gui(draft: Draft, random: np.random.Generator) -> None:
    """GUI controls: two thirds of them move two raw controls, one on each side of 0; some raw controls have a bend."""
    number = 0
    while number < len(draft.raw):
        gui = f"gui_{len(draft.gui):03d}"
        draft.gui.append(gui)
        raw = draft.raw[number]
        if random.random() < 0.2:
            draft.rows += [Row.between(gui, raw, (0, 0), (0.5, 0.35)), Row.between(gui, raw, (0.5, 0.35), (1, 1))]
        else:
            draft.rows.append(Row.between(gui, raw, (0, 0), (1, 1)))
        number += 1
        if number < len(draft.raw) and random.random() < 0.66:
            draft.rows.append(Row.between(gui, draft.raw[number], (-1, 1), (0, 0)))
            number += 1


def _add_joints(
    draft: Draft, random: np.random.Generator, vertices: np.ndarray, front: np.ndarray, joints: int, centres: np.ndarray
) -> None:
    """A root, a neck, a head, a jaw, and joints under the skin of the face; in groups of neighbours."""
    heads = [(0, 0, 0), (0, 1480, -10), (0, 1560, -20), (0, 1570, 30)]
    draft.joints = [Joint(CARRIED[0], -1, heads[0])]
    draft.joints += [
        Joint(name, parent, np.subtract(heads[number], heads[parent]))
        for number, name, parent in ((1, "neck", 0), (2, "head", 1), (3, "jaw", 2))
    ]
    points = vertices[random.choice(front, joints - len(heads), replace=False)] * 0.97 + CENTRE_MM * 0.03
    for number, point in enumerate(points):
        parent = 3 if point[1] < 1560 else 2
        rotation = random.normal(size=3) * 20
        draft.joints.append(Joint(f"face_{number:03d}", parent, point - heads[parent], rotation))
    raws, size = len(draft.raw), 20
    order = np.lexsort((points[:, 0], np.round(points[:, 1] / 25)))
    for start in range(0, len(order), size):
        members = order[start : start + size]
        away = np.linalg.norm(centres[None] - points[members, None], axis=2)
        columns = np.flatnonzero(away.min(axis=0) < 1.6 * REACH_MM)
        strength = np.exp(-0.5 * (away[:, columns] / REACH_MM) ** 2) * np.where(columns < raws, 1.0, 0.3)
        strength[strength < 0.05] = 0
        attributes = (9 * (4 + members)[:, None] + np.arange(6)).reshape(-1)
        sizes = np.repeat([[3.0], [4.0]], 3, axis=0)  # mm, degrees
        displacements = random.normal(size=(6, len(columns))) * sizes
        values = strength[:, None] * (displacements + 0.3 * sizes * random.normal(size=(len(members), 6, len(columns))))
        draft.groups.append(Group(columns, attributes, values.reshape(len(attributes), -1)))
    jaw = np.zeros((6, 4))
    jaw[[0, 1, 3, 4]] = [[3, -3, 0, 0], [0, 0, -4, 0], [22, 0, 0, -3], [0, 0, 6, 4]]
    draft.groups.append(Group(range(4), 9 * 3 + np.arange(6), jaw))


def _skin(draft: Draft, vertices: np.ndarray) -> sparse.csr_array:
    """Eight joints a vertex: the nearest of the face, and the head or the jaw where none is near."""
    worlds = [np.array(draft.joints[0].translation, dtype=float)]
    for joint in draft.joints[1:]:
        worlds.append(worlds[joint.parent] + joint.translation)
    away, near = cKDTree(np.array(worlds[4:])).query(vertices, k=7)
    weights = np.exp(-0.5 * (away / 8.0) ** 2) + 1e-3 * (away < 25)
    base = np.full((len(vertices), 1), 0.02)
    carrier = np.where((vertices[:, 1:2] < 1550) & (vertices[:, 2:] > 10), 3, 2)
    weights, near = np.concatenate([weights, base], axis=1), np.concatenate([near + 4, carrier], axis=1)
    weights[weights < 1e-4] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(vertices)), 8)
    return sparse.csr_array((weights.reshape(-1), (rows, near.reshape(-1))), shape=(len(vertices), len(draft.joints)))


def main() -> None:
    """Write a head, read it, and pose it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", help="keep the file here")
    for name, default in (("raws", 250), ("psds", 600), ("joints", 800), ("channels", 800), ("rows", 160), ("columns", 150)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    given = parser.parse_args()
    sizes = {name: getattr(given, name) for name in ("raws", "psds", "joints", "channels", "rows", "columns")}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(given.out or f"{folder}/head.dna")
        write_dna(path, make_head(**sizes).file())
        print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB; {torch.get_num_threads()} threads")
        start = time.perf_counter()
        read_dna(path)
        print(f"read in {time.perf_counter() - start:.2f} s")
        start = time.perf_counter()
        rig = DnaRig(str(path))
        print(f"made into a rig in {time.perf_counter() - start:.2f} s: {len(rig.controls)} controls, {type(rig).__name__}")
        for batch in (1, 16, 64, 256):
            print(f"{batch} poses at once: {_poses_a_second(rig, batch, given.seconds):,.0f} poses a second")


@torch.no_grad()
def _poses_a_second(rig: DnaRig, batch: int, seconds: float) -> float:
    controls = rig.lower + (rig.upper - rig.lower) * torch.rand(batch, len(rig.controls))
    rig(controls)
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        rig(controls)
        count += batch
    return count / (time.perf_counter() - start)


if __name__ == "__main__":
    main()
