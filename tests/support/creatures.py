"""Skinned creatures with animations of their own, written as glTF: tubes around bones."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.avatars import AvatarWriter

FPS = 30.0
X, Y, Z = np.eye(3)
Add = Callable[..., int]


@dataclass
class Bone:
    """A bone at rest: metres, y up.

    Attributes:
        swing: degrees that the animation rotates it by at most, about an axis of its own.
        bent: degrees between rest and the middle of the animation.
        hidden: whether no vertex follows it.
        moves, scales: whether the animation moves or scales it.
    """

    name: str
    parent: int
    head: np.ndarray
    tail: np.ndarray
    radius: float
    swing: float = 25.0
    bent: float = 0.0
    hidden: bool = False
    moves: bool = False
    scales: str = ""


@dataclass
class Creature:
    """Bones, parents before children, the first the root, and how its animation turns the root."""

    bones: list[Bone] = field(default_factory=list)
    turns: float = 0.0  # degrees about the vertical over the clip
    travel: tuple[float, float, float] = (0.0, 0.1, 1.5)  # metres over the clip; the second is a bob
    rings: int = 4
    around: int = 6

    def chain(
        self, name: str, parent: int, start: np.ndarray, step: np.ndarray, count: int, radius: float, **more
    ) -> list[int]:
        """Bones in a row; returns their numbers."""
        numbers, head = [], np.asarray(start, float)
        for number in range(count):
            tail = head + np.asarray(step, float)
            label = f"{name}{number + 1}" if count > 1 else name
            self.bones.append(Bone(label, parent, head, tail, radius * 0.9**number, **more))
            parent, head = len(self.bones) - 1, tail
            numbers.append(parent)
        return numbers


def _trunk(creature: Creature, neck: int, tail: int) -> tuple[int, int]:
    """Hips, spine, neck, head and tail; returns the numbers of hips and chest."""
    hips = creature.chain("hips", -1, [0, 0.6, 0], [0, 0, 0.12], 1, 0.1)[0]
    creature.bones[hips].moves = True
    spine = creature.chain("spine", hips, [0, 0.6, 0.12], [0, 0.01, 0.12], 4, 0.11, swing=15)
    chest = spine[-1]
    creature.bones[chest].scales = "xyz"
    necks = creature.chain("neck", chest, [0, 0.64, 0.6], [0, 0.08, 0.06], neck, 0.06, swing=20, bent=15)
    top = creature.bones[necks[-1]].tail
    head = creature.chain("head", necks[-1], top, [0, 0, 0.15], 1, 0.07, swing=30)[0]
    creature.chain("jaw", head, top - 0.03 * Y, [0, -0.02, 0.13], 1, 0.03, swing=20)
    tongue = creature.chain("tongue", head, top - 0.02 * Y, [0, 0, 0.05], 2, 0.012, swing=10)
    creature.bones[tongue[0]].moves = True
    creature.chain("head_end", head, top + 0.15 * Z, [0, 0, 0.02], 1, 0.0, hidden=True, swing=0)
    creature.chain("tail", hips, [0, 0.6, 0], [0, -0.01, -0.1], tail, 0.05, swing=30, bent=10)
    return hips, chest


def _legs(creature: Creature, hips: int, chest: int) -> None:
    for side, sign in (("L", 1), ("R", -1)):
        for end, above, z in (("hind", hips, 0.0), ("fore", chest, 0.55)):
            start = np.array([sign * 0.1, 0.55, z])
            bones = creature.chain(f"{end}_{side}_", above, start, [0, -0.12, 0.02 * sign], 4, 0.045, swing=45, bent=20)
            foot = creature.bones[bones[-1]].tail
            creature.chain(f"{end}_toe_{side}", bones[-1], foot, [0, 0, 0.08], 1, 0.02, swing=40)
            creature.chain(f"{end}_ik_{side}", hips, foot, [0, 0, 0.05], 1, 0.0, hidden=True, swing=30)


def fox() -> Creature:
    """A quadruped that gallops: 49 joints."""
    creature = Creature(around=7)
    hips, chest = _trunk(creature, 2, 7)
    _legs(creature, hips, chest)
    head = next(number for number, bone in enumerate(creature.bones) if bone.name == "head")
    for side, sign in (("L", 1), ("R", -1)):
        creature.chain(
            f"ear_{side}_", head, creature.bones[head].head + np.array([0.04 * sign, 0.05, 0]), [0, 0.04, 0], 3, 0.02, swing=30
        )
    return creature


def dragon() -> Creature:
    """A quadruped with wings that fold and beat: 99 joints."""
    creature = Creature(travel=(0.5, 0.6, 4.0), turns=120.0, rings=4, around=8)
    hips, chest = _trunk(creature, 8, 14)
    _legs(creature, hips, chest)
    for side, sign in (("L", 1), ("R", -1)):
        out = np.array([sign * 0.2, 0.03, -0.03])
        arm = creature.chain(f"wing_{side}_", chest, [sign * 0.1, 0.7, 0.55], out, 3, 0.03, swing=60, bent=50)
        wrist = creature.bones[arm[-1]].tail
        for finger in range(4):
            along = Rotation.from_rotvec(np.radians(25 * finger * sign) * Y).apply(out)
            creature.chain(f"finger_{side}_{finger}_", arm[-1], wrist, along, 4, 0.015, swing=35, bent=30)
        creature.chain(f"horn_{side}_", chest + 9, creature.bones[chest + 9].head + 0.05 * Y, [0.02 * sign, 0.05, 0], 1, 0.01)
    return creature


def spider() -> Creature:
    """Eight legs of seven joints that scuttle, and a body that turns once and a half: 64 joints."""
    creature = Creature(travel=(1.0, 0.05, 1.0), turns=540.0, rings=3, around=5)
    body = creature.chain("body", -1, [0, 0.3, 0], [0, 0, 0.2], 1, 0.12)[0]
    creature.bones[body].moves = True
    abdomen = creature.chain("abdomen", body, [0, 0.3, 0], [0, 0.05, -0.15], 3, 0.15, swing=15)
    creature.bones[abdomen[1]].scales = "uniform"
    for side, sign in (("L", 1), ("R", -1)):
        creature.chain(f"fang_{side}_", body, [0.04 * sign, 0.3, 0.2], [0, -0.03, 0.03], 2, 0.015, swing=50)
        for leg in range(4):
            out = Rotation.from_rotvec(np.radians((leg - 1.5) * -30 * sign) * Y).apply([0.11 * sign, 0.0, 0.0])
            creature.chain(f"leg_{side}_{leg}_", body, [0.1 * sign, 0.3, 0.15 - 0.08 * leg], out, 7, 0.02, swing=50, bent=25)
    return creature


CREATURES: dict[str, Callable[[], Creature]] = {"fox": fox, "dragon": dragon, "spider": spider}


def write_creature(path: Path, creature: Creature, frames: int = 84, unit: float = 1.0, seed: int = 5) -> Path:
    """Write a creature with one animation as a .glb.

    Args:
        unit: units of the file to a metre, as a scale of the node above the root.
    """
    rng, avatar = np.random.default_rng(seed), AvatarWriter()
    up = Rotation.from_euler("x", -90, degrees=True)
    armature = avatar.node("Armature", rotation=up.as_quat().tolist(), scale=[unit] * 3)
    above = np.eye(4)
    above[:3, :3] = unit * up.as_matrix()
    worlds, nodes, channels = [], [], []
    times = np.arange(frames) / FPS
    for bone in creature.bones:
        world = np.eye(4)
        world[:3, :3], world[:3, 3] = unit * _frame(bone, rng), unit * bone.head
        local = np.linalg.inv(worlds[bone.parent] if bone.parent >= 0 else above) @ world
        rotation, place = Rotation.from_matrix(local[:3, :3]), local[:3, 3]
        fields = {"rotation": rotation.as_quat().tolist(), "translation": place.tolist(), "scale": [1.0, 1.0, 1.0]}
        nodes.append(avatar.node(bone.name, nodes[bone.parent] if bone.parent >= 0 else armature, **fields))
        worlds.append(world)
        channels += _channels(creature, bone, nodes[-1], rotation, place, times, rng)
    points, weights, joints, faces = _tubes(creature)
    binds = np.linalg.inv(np.array(worlds))
    skin = avatar.skin(nodes, binds)
    more = {"JOINTS_0": avatar.accessor(joints, "u1"), "WEIGHTS_0": avatar.accessor(weights)}
    mesh = avatar.mesh("skin", [avatar.primitive(avatar.accessor(points * unit), faces, **more)])
    avatar.node("skin", mesh=mesh, skin=skin)
    avatar.animation("gait", *channels)
    return avatar.write(path)


def _frame(bone: Bone, rng: np.random.Generator) -> np.ndarray:
    """Axes of a bone as Blender has them: the second along the bone, any roll."""
    along = (bone.tail - bone.head) / np.linalg.norm(bone.tail - bone.head)
    first = np.cross(along, rng.normal(size=3))
    first /= np.linalg.norm(first)
    return np.stack([first, along, np.cross(first, along)], axis=1)


def _channels(creature, bone: Bone, node: int, rest: Rotation, place: np.ndarray, times: np.ndarray, rng) -> list[tuple]:
    """Rotation, translation and scale of a bone, all written, as exporters do."""
    phase = 2 * np.pi * (times / times[-1] * rng.integers(1, 5) + rng.random())
    axis, bend = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    swing = Rotation.from_rotvec(np.outer(np.radians(bone.swing) * np.sin(phase), axis))
    turn = rest * Rotation.from_rotvec(np.radians(bone.bent) * bend) * swing
    places, scales, along = np.tile(place, (len(times), 1)), np.ones((len(times), 3)), times / times[-1]
    if bone.parent < 0:
        turn = Rotation.from_rotvec(np.outer(np.radians(creature.turns) * along, Z)) * turn
        x, bob, z = creature.travel
        places = place + np.stack([x * along, -z * along, bob * np.sin(phase)], axis=1)
    elif bone.moves:
        places = place + 0.4 * np.outer(np.sin(phase), np.linalg.norm(bone.tail - bone.head) * axis)
    if bone.scales:
        wave = np.stack([np.sin(phase + shift) for shift in ((0, 2, 4) if bone.scales == "xyz" else (0, 0, 0))], axis=1)
        scales = 1 + 0.2 * wave
    quaternions = turn.as_quat() * np.where(np.arange(len(times)) % 7 == 3, -1.0, 1.0)[:, None]  # the same rotations
    return [(node, "rotation", times, quaternions), (node, "translation", times, places), (node, "scale", times, scales)]


def _tubes(creature: Creature) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, their weights, the joints of these, and triangles."""
    points, weights, joints, faces = [], [], [], []
    angles = np.linspace(0, 2 * np.pi, creature.around, endpoint=False)
    for number, bone in enumerate(creature.bones):
        if bone.hidden:
            continue
        axes = _frame(bone, np.random.default_rng(number))
        circle = bone.radius * (np.outer(np.cos(angles), axes[:, 0]) + np.outer(np.sin(angles), axes[:, 2]))
        child = next((n for n, other in enumerate(creature.bones) if other.parent == number and not other.hidden), number)
        first = len(points)
        for ring, along in enumerate(np.linspace(0.05, 0.95, creature.rings)):
            to_parent, to_child = max(0.0, 0.45 - 1.3 * along), max(0.0, 1.3 * along - 0.85)
            points += list(bone.head + along * (bone.tail - bone.head) + circle)
            row = [1 - to_parent - to_child, to_parent if bone.parent >= 0 else 0.0, to_child, 0.0]
            weights += [np.array(row) / sum(row)] * creature.around
            joints += [[number, max(bone.parent, 0), child, 0]] * creature.around
            if ring:
                before = first + (ring - 1) * creature.around + np.arange(creature.around)
                beside = np.roll(before, -1)
                quads = np.stack([before, beside, beside + creature.around, before + creature.around], axis=1)
                faces += [*quads[:, [0, 1, 2]], *quads[:, [0, 2, 3]]]
    return np.array(points), np.array(weights), np.array(joints), np.array(faces)
