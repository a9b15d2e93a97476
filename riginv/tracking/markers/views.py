"""The page and the contact sheet of an inversion of markers: the rig with its markers, and with those observed, as balls."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv.animation.animation import Animation, FrameErrors
from riginv.clips.description import ClipDescription
from riginv.geometry.kinematics import remove_motion
from riginv.meshes.rendering import CLAY
from riginv.rig.interface import RigBackend
from riginv.tracking.markers.placement import Placement
from riginv.tracking.markers.tracking import MarkerTrack
from riginv.tracking.options import LookOptions
from riginv.tracking.results import source_of, write_look
from riginv.tracking.run import Advance

BALL = 0.012  # radius of a marker, relative to the rig's size
RED = np.array([0.85, 0.1, 0.1])


class RigWithMarkers(RigBackend):
    """A rig's mesh together with its markers as balls.

    Args:
        rig: the rig.
        placement: of the markers.
        detail: subdivisions of a ball.

    Attributes:
        balls: the corners of a ball around the origin, `(corner, 3)`, mm.
        ball_faces: its triangles `(face, 3)`.
    """

    balls: Tensor

    def __init__(self, rig: RigBackend, placement: Placement, detail: int = 0) -> None:
        import trimesh  # half a second, and only markers need it

        rest = rig.rest_vertices
        ball = trimesh.creation.icosphere(detail, radius=BALL * float((rest.amax(dim=0) - rest.amin(dim=0)).max()))
        count, size = len(placement), len(ball.vertices)
        ball_faces = torch.from_numpy(ball.faces).to(rig.faces)
        triangles = ball_faces + len(rest) + size * torch.arange(count)[:, None, None]
        balls = torch.from_numpy(ball.vertices).to(rest)
        vertices = with_balls(rest[None], placement.points(rest)[None], balls)[0]
        super().__init__(rig.name, rig.controls, vertices, torch.cat([rig.faces, triangles.flatten(0, 1)]))
        self.register_buffer("balls", balls, persistent=False)
        self.source, self.placement, self.ball_faces = rig, placement, ball_faces

    def forward(self, controls: Tensor) -> Tensor:
        mesh = self.source(controls)
        return with_balls(mesh, self.placement.points(mesh), self.balls)

    def vertex_colors(self) -> Tensor:
        """The rig's colours, and red balls."""
        own = self.source.vertex_colors()
        skin = torch.from_numpy(CLAY).expand(len(self.source.rest_vertices), 3) if own is None else own
        more = len(self.rest_vertices) - len(skin)
        return torch.cat([skin.float().cpu(), torch.from_numpy(RED).float().expand(more, 3)])


def with_balls(meshes: Tensor, points: Tensor, balls: Tensor) -> Tensor:
    """Meshes `(frame, vertex, 3)` followed by a ball `(corner, 3)` around each point `(frame, marker, 3)`."""
    return torch.cat([meshes, (points[:, :, None] + balls).flatten(1, 2)], dim=1)


def write_marker_views(
    folder: Path,
    track: MarkerTrack,
    animation: Animation,
    errors: FrameErrors,
    look: LookOptions,
    clip: ClipDescription,
    advance: Advance,
) -> tuple[list[str], list[str]]:
    """Write the page, the contact sheet and TensorBoard events into a folder; the names of the files, and notes."""
    rig = RigWithMarkers(animation.rig, track.placement)
    shown = replace(animation, rig=rig)
    observed = track.points if track.motion is None else remove_motion(track.motion, track.points)

    @torch.no_grad()
    def targets(wanted: Sequence[int]) -> Tensor:
        some = list(wanted)
        return with_balls(animation.rig(track.controls[some]), observed[some], rig.balls)

    return write_look(folder, shown, errors, look, source_of(clip), targets, advance)
