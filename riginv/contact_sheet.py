"""python -m riginv.contact_sheet: what a rig looks like, as one picture."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "contact_sheet")  # before the imports that take seconds

from dataclasses import dataclass

import torch
from omegaconf import DictConfig
from PIL import Image
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.config.values import NonNegativeInt, PositiveInt
from riginv.meshes.rendering import Camera, grid
from riginv.rig.batches import generator_at
from riginv.rig.interface import RigBackend
from riginv.rig.random_controls import sparse_controls
from riginv.rig.size import show_rig
from riginv.runs.console import show_result
from riginv.runs.files import atomic_write, free_file


@dataclass(frozen=True)
class ContactSheetConfig:
    """The config of `riginv.contact_sheet`; conf/contact_sheet.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    out: str
    expressions: NonNegativeInt | None
    random_poses: NonNegativeInt
    columns: PositiveInt
    turn_degrees: float
    seed: NonNegativeInt


def contact_sheet(config: DictConfig) -> None:
    """Draw neutral, every named expression and random poses of a rig."""
    settings = to_typed(config, ContactSheetConfig)
    out = free_file(settings.out, ".png")
    rig = settings.rig.build()
    show_rig(rig, settings.rig.config)
    named = named_poses(rig)
    shown = dict(list(named.items())[: settings.expressions])
    poses = {"neutral": rig.neutral_controls, **shown, **random_poses(rig, settings.random_poses, settings.seed)}
    sheet = draw(rig, poses, settings.columns, settings.turn_degrees)
    with atomic_write(out) as beside:
        sheet.save(beside, format="PNG")
    more = len(named) - len(shown)
    left_out = f"; {more} more of its expressions are not drawn (expressions=null draws all)" if more else ""
    show_result(f"{out}: {len(poses)} poses of rig '{rig.name}'{left_out}")


def named_poses(rig: RigBackend) -> dict[str, Tensor]:
    """The controls `(control,)` of a rig's named expressions."""
    place = {name: number for number, name in enumerate(rig.control_names)}
    poses = {}
    for name, changes in rig.expressions().items():
        poses[name] = rig.neutral_controls.clone()
        for control, value in changes.items():
            poses[name][place[control]] = value
    return poses


def random_poses(rig: RigBackend, count: int, seed: int) -> dict[str, Tensor]:
    """Controls `(control,)` of the paper's random poses, named by how many leave neutral."""
    limits = rig.lower, rig.upper, rig.neutral_controls
    controls = sparse_controls(*limits, len(rig.controls), count, generator_at(seed, "contact sheet"))
    active = (controls != rig.neutral_controls).sum(dim=1).tolist()
    return {f"random {number}: {many} controls": row for number, (many, row) in enumerate(zip(active, controls), start=1)}


@torch.no_grad()
def draw(rig: RigBackend, poses: dict[str, Tensor], columns: int, turn_degrees: float) -> Image.Image:
    """A grid of pictures of the poses `(control,)`, by name."""
    camera, colors = Camera(rig.rest_vertices, turn_degrees), rig.vertex_colors()
    meshes = [rig(controls[None])[0] for controls in poses.values()]
    pictures = [camera.following(mesh).picture(mesh, rig.faces, colors) for mesh in meshes]
    return grid(pictures, list(poses), columns)


if __name__ == "__main__":
    command("contact_sheet")(contact_sheet)()
