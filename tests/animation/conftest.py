"""Animations of a toy and of the body, written in their formats."""

import pytest

from riginv.animation.formats import write_formats
from tests.support.animations import errors_of, has_usd, moving
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def toy_written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    animation = moving(ToyRig())
    names = ["csv", "glb", "anim", "blender"]
    if has_usd():
        names.append("usd")
    write_formats(folder, animation, errors_of(animation), names)
    return folder, animation


@pytest.fixture(scope="module")
def body_written(tmp_path_factory, body):
    folder = tmp_path_factory.mktemp("body")
    animation = moving(body)
    write_formats(folder, animation, errors_of(animation), ["glb", "bvh", *(["usd"] if has_usd() else [])])
    return folder, animation
