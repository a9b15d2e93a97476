"""A capture of somebody who does not look like the default face, for docs/actors.md.

    python examples/another_actor.py OUT [--take take.csv] [--frames 120] [--stride 1] [--seed 0] [--still]
    python examples/another_actor.py OUT --compare FOUND

OUT gets `take.npz`, a clip of an actor whose face at rest lies 4.3 mm from the rig's and whose head moves, `neutral.obj`, the
actor at rest, and `truth.csv`, the controls that made it. The expressions are a simulated performance or a Live Link
Face recording, by the face's own logic; the actor is a smooth random field on top. FOUND is the folder of riginv.invert.
"""

import argparse
import csv
from pathlib import Path

import numpy as np
import roma
import torch
from torch import Tensor

from riginv.clips.performance import simulated_performance
from riginv.geometry.kinematics import apply_motion, remove_motion
from riginv.meshes.obj import obj_text
from riginv.tracking.rigid import fit_rigid
from rigs.face import FaceRig

OFFSET_MM, BUMPS, WIDTH_MM = 4.3, 40, 35.0  # mean size of the field, and the smooth bumps that make it
FPS = 30.0
USED = 0.01  # a control that exceeds it in some frame is used


def offset_field(rest: Tensor, seed: int) -> Tensor:
    """A smooth field `(vertex, 3)` of `OFFSET_MM` on average, without rigid motion."""
    generator = torch.Generator().manual_seed(seed)
    centres = rest[torch.randint(0, len(rest), (BUMPS,), generator=generator)]
    field = torch.exp(-0.5 * (torch.cdist(rest, centres) / WIDTH_MM) ** 2) @ torch.randn(BUMPS, 3, generator=generator)
    for _ in range(3):
        field *= OFFSET_MM / field.norm(dim=1).mean()
        motion = fit_rigid(rest[None], (rest + field)[None], torch.ones(len(rest)))
        field = remove_motion(motion, (rest + field)[None])[0] - rest
    return field


def head_motion(frames: int) -> Tensor:
    """Rotations by up to 20 degrees and translations by up to 30 mm, `(frame, 4, 4)`."""
    seconds = torch.arange(frames)[:, None] / FPS
    turns = torch.tensor([0.25, 0.3, 0.1]) * torch.sin(seconds * torch.tensor([0.9, 1.5, 2.1]))
    motion = torch.eye(4).repeat(frames, 1, 1)
    motion[:, :3, :3] = roma.rotvec_to_rotmat(turns)
    motion[:, :3, 3] = 30 * torch.sin(seconds * torch.tensor([1.0, 0.7, 1.3]))
    return motion


def recorded(take: Path, names: list[str]) -> Tensor:
    """The curves `(frame, shape)` of a Live Link Face recording."""
    with take.open() as file:
        rows = list(csv.DictReader(file))
    return torch.tensor([[float(row[name[0].upper() + name[1:]]) for name in names] for row in rows])


def compare(truth: Path, found: Path) -> None:
    """Print the error of the controls that are used."""
    with truth.open() as one, (found / "curves.csv").open() as other:
        curves, controls = list(csv.DictReader(one)), list(csv.DictReader(other))
    errors = []
    for name in curves[0]:
        true, own = (np.array([float(row[name]) for row in rows]) for rows in (curves, controls))
        if true.max() > USED:
            errors.append(np.abs(own - true).mean())
    print(f"mean error of the {len(errors)} controls that are used: {np.mean(errors):.4f} of their ranges")


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--take", type=Path)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--stride", type=int, default=1, help="takes every so many frames")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--still", action="store_true", help="no head motion")
    parser.add_argument("--compare", type=Path, help="the folder of riginv.invert")
    given = parser.parse_args()
    if given.compare:
        compare(given.out / "truth.csv", given.compare)
        return
    rig = FaceRig()
    names = list(rig.arkit_deltas())
    curves = (
        recorded(given.take, names) if given.take else simulated_performance(rig, max(900, given.stride * given.frames)).weights
    )
    curves = curves[:: given.stride].clamp(0, 1)
    first = max(len(curves) - given.frames, 0) // 2
    curves = curves[first : first + given.frames]
    controls = rig.neutral_controls.repeat(len(curves), 1)
    controls[:, [rig.control_names.index(name) for name in names]] = curves.to(controls)
    neutral = rig.rest_vertices + offset_field(rig.rest_vertices, given.seed)
    meshes = torch.cat([rig(batch) for batch in controls.split(64)]) - rig.rest_vertices + neutral
    if not given.still:
        motion = head_motion(len(meshes))
        meshes = apply_motion(motion, meshes)
        neutral = apply_motion(motion[len(motion) // 2][None], neutral[None])[0]
    given.out.mkdir(parents=True, exist_ok=True)
    np.savez(given.out / "take.npz", vertices=meshes.numpy(), faces=rig.faces.numpy(), fps=FPS)
    (given.out / "neutral.obj").write_text(obj_text(neutral.numpy(), rig.faces.numpy()))
    with (given.out / "truth.csv").open("w", newline="") as file:
        csv.writer(file).writerows([names, *curves.tolist()])


if __name__ == "__main__":
    main()
