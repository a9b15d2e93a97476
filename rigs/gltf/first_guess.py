"""A first guess at the controls of joints: the rotation of each by the vertices that follow it, from root to leaf."""

import roma
import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.euler import continuous_angles, euler_angles
from riginv.geometry.kinematics import compose, transform_from
from rigs.gltf.motion import JointMotion

POWER = 3  # of the skin weights: vertices that follow a joint alone count most
BESIDE = 0.05  # of a bone's square: how much the rotations of parent and child decide on that of a joint without vertices
HELD = 2e-3  # of a joint's vertices: how much the parent's rotation counts, which decides where they are too few
DOMINANT = 0.5  # greatest skin weight of a joint: with less it has no vertices of its own, and takes all below it


class FirstGuess:
    """Fits the joints of a skin to meshes.

    Args:
        motion: of the joints.
        rest_vertices: `(vertex, 3)`, mm.
        points: for each frame the vertices that it moves times their weights, about its rest position, and the weights:
            `(frame, 4, vertex)`.
    """

    def __init__(self, motion: JointMotion, rest_vertices: Tensor, points: Tensor) -> None:
        self.motion, rest, points = motion, rest_vertices.double(), points.double()
        weights = points[:, 3]
        below = motion.tree.below.double() @ weights
        alone = weights.pow(POWER)
        poor = weights.amax(dim=1) < DOMINANT
        centres = motion.rest[..., 3].double()
        own = points[:, :3].mT / weights[..., None].clamp_min(1e-9)
        places = torch.where(poor[:, None, None], rest - centres[:, None], own)
        alone = torch.where(poor[:, None], below.pow(POWER), alone)
        alone = alone / alone.sum(dim=1, keepdim=True).clamp_min(1e-12)
        self.middles = (alone[..., None] * places).sum(dim=1)
        around = alone[..., None] * (places - self.middles[:, None])
        self.spread = (around * (places - self.middles[:, None])).sum(dim=(1, 2)).float()
        self.estimate = torch.cat([around.mT, alone[:, None]], dim=1).flatten(0, 1).float()  # (4 frame, vertex)
        self.middles = self.middles.float()
        self.poor = set(poor.nonzero()[:, 0].tolist())
        linear = motion.rest[..., :3]
        self.upright = roma.special_procrustes(linear.double()).float()  # the frames' axes without their scales

    def __call__(self, vertices: Float[Tensor, "mesh vertex 3"], lower: Tensor, upper: Tensor) -> Tensor:
        """Controls of joints `(mesh, joint control)` of consecutive meshes; angles change least from one to the next."""
        vertices = vertices.float()
        found = (self.estimate @ vertices).unflatten(1, (-1, 4))
        covariance, centre = found[:, :, :3].mT, found[:, :, 3]
        rotations = self._rotations(covariance)
        self._bridge(rotations, centre)
        motion = self.motion
        parents = torch.tensor(motion.parents)
        above = torch.where((parents < 0)[:, None, None], torch.eye(3), rotations[:, parents.clamp_min(0)])
        relative = self.upright.mT @ above.mT @ rotations @ self.upright
        angles = euler_angles(relative, motion.orders)
        limits = (torch.deg2rad(one[: 3 * motion.count]).unflatten(0, (-1, 3)).to(angles) for one in (lower, upper))
        angles = torch.rad2deg(continuous_angles(angles, motion.orders, *limits)).flatten(1)
        moves = self._moves(rotations, relative, centre)
        return torch.cat([angles, moves.flatten(1), angles.new_ones(len(angles), len(motion.scaled))], dim=1)

    def _rotations(self, covariance: Tensor) -> Tensor:
        """Rotations `(mesh, frame, 3, 3)` in the world, relative to rest."""
        parents = torch.tensor(self.motion.parents)
        result = torch.eye(3).expand(covariance.shape).clone()
        for depth, level in enumerate(self.motion.levels):
            above = result[:, parents[level]] if depth else torch.eye(3)
            held = HELD * self.spread[level].clamp_min(1e-12)[:, None, None] * above
            result[:, level] = roma.special_procrustes(covariance[:, level] + held)
        return result

    def _bridge(self, rotations: Tensor, centre: Tensor) -> None:
        """Replace the rotations of joints without vertices: each points from where its parent carries it to its children."""
        parents, places = self.motion.parents, self.motion.rest[..., 3]

        def carried(place: Tensor, joint: int) -> Tensor:
            offset = place - places[joint] - self.middles[joint]
            return centre[:, joint] + (rotations[:, joint] @ offset[:, None])[..., 0]

        for joint in (joint for level in self.motion.levels for joint in level.tolist() if joint in self.poor):
            children, parent = [child for child, above in enumerate(parents) if above == joint], parents[joint]
            if not children:
                continue
            start = carried(places[joint], parent if parent >= 0 else joint)
            total = torch.zeros_like(rotations[:, joint])
            for child in children:
                bone, ends = places[child] - places[joint], carried(places[child], child) - start
                beside = rotations[:, child] + (rotations[:, parent] if parent >= 0 else 0.0)
                total += ends[:, :, None] * bone + BESIDE * bone.square().sum().clamp_min(1e-6) * beside
            rotations[:, joint] = roma.special_procrustes(total)

    def _moves(self, rotations: Tensor, relative: Tensor, centre: Tensor) -> Tensor:
        """Translations `(mesh, moved frame, 3)`, from where the fitted vertices are."""
        motion = self.motion
        number_of = {frame: number for number, frame in enumerate(motion.moved.tolist())}
        moves = rotations.new_zeros(len(rotations), len(number_of), 3)
        worlds = torch.eye(4)[:3].repeat(len(rotations), motion.count, 1, 1)
        local_linear = self.upright @ relative @ self.upright.mT
        for level in motion.levels:
            for frame in level.tolist():
                parent, rest = motion.parents[frame], motion.rest[frame]
                above = worlds[:, parent] if parent >= 0 else torch.eye(4)[:3].expand(len(rotations), -1, -1)
                place = compose(above, rest.expand_as(above))
                origin = place[..., 3]
                if frame in number_of:
                    wanted = centre[:, frame] - (rotations[:, frame] @ self.middles[frame, :, None])[..., 0]
                    axes = place[..., :3] @ motion.move_axes[number_of[frame]]
                    moves[:, number_of[frame]] = torch.linalg.solve(axes, wanted - origin)
                    origin = wanted
                linear = above[..., :3] @ local_linear[:, frame]
                worlds[:, frame] = transform_from(linear, origin - (linear @ rest[:, 3:])[..., 0])
        return moves


def joint_points(basis: Float[Tensor, "coefficient vertex 3"], first: int, frames: int) -> Float[Tensor, "frame 4 vertex"]:
    """Weighted points and weights of frames, from the rows of a basis that begin at `first`."""
    return basis[first : first + 12 * frames].view(frames, 3, 4, -1, 3)[:, 0, :, :, 0]
