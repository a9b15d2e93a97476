"""Rendering of meshes: ray casting by trimesh, shaded as clay."""

import copy
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from PIL import Image, ImageDraw
from torch import Tensor

from riginv.rig.interface import RigBackend

if TYPE_CHECKING:
    import trimesh

BACKGROUND = np.array([0.93, 0.93, 0.94])
CLAY = np.array([0.80, 0.62, 0.53])
KEY_LIGHT, FILL_LIGHT, RIM_LIGHT = np.array([-0.45, 0.55, 0.75]), np.array([0.7, 0.1, 0.5]), np.array([0.0, 0.6, -0.6])
AMBIENT, KEY, FILL, RIM, SHINE, GAMMA = 0.16, 0.72, 0.28, 0.10, 0.12, 1.6
HEAT_STOPS = np.array([[0.27, 0.33, 0.55], [0.35, 0.66, 0.62], [0.93, 0.86, 0.45], [0.85, 0.36, 0.22], [0.55, 0.05, 0.13]])
UNKNOWN = np.full(3, 0.43)  # the colour of unknown distances
HARD_EDGE = np.radians(30)
FONT_SIZE, LINE, MARGIN, MOST_LINES, INK = 13, 16, 6, 3, (40, 40, 46)  # of labels
BREAKS = re.compile(r"[^\s_]*[\s_]*")  # labels are wrapped after spaces and underscores
DISTANCE = 12.0  # of the camera, in half-heights of the picture: weak perspective


class Camera:
    """A camera at the centre of a rest mesh, from the front and rotated by some degrees, for all poses.

    `following` moves it only for poses outside the picture, so that pictures of poses are comparable.
    """

    def __init__(self, vertices: Tensor, turn_degrees: float = 15.0, size: tuple[int, int] = (240, 290)) -> None:
        points = vertices.detach().cpu().double().numpy()
        self.middle = (points.max(axis=0) + points.min(axis=0)) / 2
        angle = np.radians(-turn_degrees)
        cos, sin = np.cos(angle), np.sin(angle)
        self.rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
        self.size = size
        extent = np.abs((points - self.middle) @ self.rotation.T).max(axis=0)
        self.half_height = 1.1 * max(extent[1], extent[0] * size[1] / size[0])

    def following(self, *meshes: Tensor) -> "Camera":
        """This camera, or a moved copy where meshes `(vertex, 3)` extend beyond its picture."""
        points = np.concatenate([mesh.detach().cpu().double().numpy() for mesh in meshes])
        width = self.half_height * self.size[0] / self.size[1]
        x, y, _ = np.abs((points - self.middle) @ self.rotation.T).max(axis=0)
        if x <= width and y <= self.half_height:
            return self
        moved = copy.copy(self)
        rotated = points @ self.rotation.T
        moved.middle = (rotated.max(axis=0) + rotated.min(axis=0)) / 2 @ self.rotation
        extent = (rotated.max(axis=0) - rotated.min(axis=0)) / 2
        moved.half_height = max(self.half_height, 1.1 * max(extent[1], extent[0] * self.size[1] / self.size[0]))
        return moved

    def picture(
        self, vertices: Tensor, faces: Tensor, colors: Tensor | np.ndarray | None = None, smooth: int = 2
    ) -> Image.Image:
        """A picture of one mesh; arguments as for `pictures`."""
        return self.pictures(vertices, faces, [colors], smooth)[0]

    def pictures(
        self, vertices: Tensor, faces: Tensor, colors: Sequence[Tensor | np.ndarray | None], smooth: int = 2
    ) -> list[Image.Image]:
        """Pictures of one mesh in several colours, from the same rays.

        Args:
            vertices: `(vertex, 3)`, mm.
            faces: `(face, 3)`.
            colors: of each picture: `(vertex, 3)` in [0, 1]; None: clay.
            smooth: supersampling: rays along each side of a pixel.
        """
        import trimesh  # half a second, which commands that draw nothing need not wait for

        points = (vertices.detach().cpu().double().numpy() - self.middle) @ self.rotation.T / self.half_height
        triangles = faces.cpu().numpy()
        mesh = trimesh.Trimesh(points, triangles, process=False)
        width, height = self.size[0] * smooth, self.size[1] * smooth
        origin, directions = self._rays(width, height)
        ray, face = self._hits(mesh, origin, directions)
        empty = np.broadcast_to(_to_bytes(BACKGROUND), (height * width, 3))
        found = [empty.copy() for _ in colors]
        if len(ray):
            corners, towards = triangles[face], directions[ray]
            weights = _barycentric(points[corners], origin, towards)
            smooth_normals = _unit(np.einsum("ijk,ij->ik", mesh.vertex_normals[corners], weights))
            normals = mesh.face_normals[face] if is_angular(mesh) else smooth_normals
            inside = _dot(normals, towards)[:, None] > 0
            normals = np.where(inside, -0.6 * normals, normals)
            for pixels, of_vertices in zip(found, colors):
                painted = CLAY if of_vertices is None else np.einsum("ijk,ij->ik", np.asarray(of_vertices)[corners], weights)
                pixels[ray] = _to_bytes(shade(painted, normals))
        pictures = [Image.fromarray(pixels.reshape(height, width, 3)) for pixels in found]
        return [picture.resize(self.size, Image.Resampling.LANCZOS) for picture in pictures]

    @staticmethod
    def _hits(mesh: "trimesh.Trimesh", origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rays that hit a mesh, by number, and the first face of each; only rays near the mesh's outline are cast."""
        near = np.ones(len(directions), dtype=bool)
        for axis in (0, 1):
            slopes = (mesh.vertices[:, axis] - origin[axis]) / (origin[2] - mesh.vertices[:, 2])
            ray = directions[:, axis] / -directions[:, 2]
            near &= (ray >= slopes.min()) & (ray <= slopes.max())
        near = near.nonzero()[0]
        face = mesh.ray.intersects_first(np.broadcast_to(origin, (len(near), 3)), directions[near])
        return near[face >= 0], face[face >= 0]

    def _rays(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        x = ((np.arange(width) + 0.5) / width * 2 - 1) * width / height
        y = 1 - (np.arange(height) + 0.5) / height * 2
        across, up = np.meshgrid(x, y)
        origin = np.array([0.0, 0.0, DISTANCE])
        return origin, _unit(np.stack([across.ravel(), up.ravel(), np.zeros(across.size)], axis=1) - origin)


def _to_bytes(colors: np.ndarray) -> np.ndarray:
    return (colors ** (1 / GAMMA) * 255).round().astype(np.uint8)


def _barycentric(corners: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Barycentric coordinates `(ray, 3)` of where rays meet triangles `(ray, 3, 3)` (Moeller and Trumbore 1997)."""
    first, second, start = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], origin - corners[:, 0]
    across = np.cross(directions, second)
    determinant = _dot(first, across)
    u = _dot(start, across) / determinant
    v = _dot(directions, np.cross(start, first)) / determinant
    return np.stack([1 - u - v, u, v], axis=1)


def is_angular(mesh: "trimesh.Trimesh") -> bool:
    """Whether a mesh has mostly hard edges, like a box."""
    return len(mesh.face_adjacency_angles) > 0 and float(np.median(mesh.face_adjacency_angles)) > HARD_EDGE


def shade(colors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Shade colours `(point, 3)` by normals `(point, 3)`: key, fill and rim light, and a weak highlight."""

    def light(direction: np.ndarray) -> np.ndarray:
        return np.clip(normals @ _unit(direction), 0, None)[:, None]

    lit = AMBIENT + KEY * light(KEY_LIGHT) + FILL * light(FILL_LIGHT) + RIM * light(RIM_LIGHT)
    shine = SHINE * light(_unit(KEY_LIGHT) + np.array([0.0, 0.0, 1.0])) ** 24
    return np.clip(colors * lit + shine, 0, 1)


def heat_colors(distances: Tensor, top: float) -> np.ndarray:
    """Colours `(vertex, 3)` for distances `(vertex,)`: blue at 0, dark red from `top` upwards, grey where they are NaN."""
    position = np.clip(distances.detach().cpu().numpy() / max(top, 1e-9), 0, 1) * (len(HEAT_STOPS) - 1)
    colors = np.stack([np.interp(position, np.arange(len(HEAT_STOPS)), stop) for stop in HEAT_STOPS.T], axis=1)
    return np.where(np.isnan(position)[:, None], UNKNOWN, colors)


def grid(pictures: list[Image.Image], labels: list[str], columns: int) -> Image.Image:
    """Pictures of one size in rows, each below its label, which is wrapped to its width."""
    width, height = pictures[0].size
    lines = [wrapped(label, width - 2 * MARGIN) for label in labels]
    band = max(map(len, lines)) * LINE + MARGIN
    rows = -(-len(pictures) // columns)
    paper = tuple((BACKGROUND ** (1 / GAMMA) * 255).astype(int))
    sheet = Image.new("RGB", (width * columns, (height + band) * rows), paper)
    draw = ImageDraw.Draw(sheet)
    for number, (picture, text) in enumerate(zip(pictures, lines)):
        left, top = number % columns * width, number // columns * (height + band)
        for row, line in enumerate(text):
            draw.text((left + MARGIN, top + MARGIN // 2 + row * LINE), line, fill=INK, font_size=FONT_SIZE)
        sheet.paste(picture, (left, top + band))
    return sheet


def wrapped(text: str, width: float) -> list[str]:
    """A text wrapped to a width in pixels, with too long words broken, and cut after `MOST_LINES` lines."""
    lines = [line for part in text.split("\n") for line in _broken(part, width)] or [""]
    if len(lines) <= MOST_LINES:
        return lines
    last = f"{lines[MOST_LINES - 1]}..."
    while _pixels(last) > width:
        last = f"{last[:-4]}..."
    return [*lines[: MOST_LINES - 1], last]


def _broken(text: str, width: float) -> list[str]:
    """One line of text, wrapped to a width in pixels; no lines for an empty one."""
    lines = [""]
    for word in BREAKS.findall(text):
        if lines[-1] and _pixels(f"{lines[-1]}{word}".rstrip()) > width:
            lines.append("")
        while _pixels(word.rstrip()) > width:
            fits = next(count for count in range(len(word) - 1, 0, -1) if count == 1 or _pixels(word[:count]) <= width)
            lines[-1:] = [word[:fits], ""]
            word = word[fits:]
        lines[-1] += word
    return [line.rstrip() for line in lines if line.strip()]


def _pixels(text: str) -> float:
    return ImageDraw.Draw(Image.new("RGB", (1, 1))).textlength(text, font_size=FONT_SIZE)


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", first, second)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None], 1e-12)


class Pair(NamedTuple):
    """A target mesh and a resulting one, each `(vertex, 3)`, mm, with a label."""

    label: str
    target: Tensor
    result: Tensor


def comparison(rig: RigBackend, pairs: list[Pair]) -> Image.Image:
    """A row for each pair: target, result, and a heat map of the error, scaled to the row's maximum."""
    camera, faces, colors = Camera(rig.rest_vertices), rig.faces, rig.vertex_colors()
    colors = None if colors is None else colors.cpu()
    pictures, labels = [], []
    for label, target, result in pairs:
        distances = (result - target).norm(dim=1)
        top = float(distances.max())
        heat = heat_colors(distances, top)
        view = camera.following(target, result)
        pictures += [view.picture(target, faces, colors), *view.pictures(result, faces, [colors, heat])]
        labels += [label, "result", f"error: mean {float(distances.mean()):.2f}, red {top:.1f} mm"]
    return grid(pictures, labels, columns=3)
