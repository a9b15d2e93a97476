"""The times of Alembic archives' samples, from archives written byte by byte."""

import struct

import numpy as np
import pytest

from rigs.blender.in_blender.alembic_times import ACYCLIC, archive_frames

DEFAULT = (1, 1.0, [0.0])  # every archive has it: one sample a second


def archive(path, *samplings, metadata="_ai_Application=Maya"):
    """An Ogawa archive of nothing but a root group with metadata and time samplings."""
    content = bytearray(b"Ogawa\xff\x00\x01" + bytes(8))

    def data(value):
        content.extend(struct.pack("<Q", len(value)) + value)
        return (len(content) - len(value) - 8) | 1 << 63

    times = b"".join(
        struct.pack(f"<IdI{len(one)}d", count, period, len(one), *one) for count, period, one in (DEFAULT, *samplings)
    )
    children = [data(bytes(4)), data(bytes(4)), 1 << 63, data(metadata.encode()), data(times), data(b"")]
    content[8:16] = struct.pack("<Q", len(content))
    content.extend(struct.pack("<Q6Q", len(children), *children))
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("sampling", "fps", "first", "count"),
    [
        ((24, 1 / 24, [1001 / 24]), 24, 1001, 24),
        ((300, 1.001 / 30, [1.001 / 30]), 30 / 1.001, 1, 300),
        ((12, 1 / 60, [0.0]), 60, 0, 12),
        ((10, 1 / 25, [-5 / 25]), 25, -5, 10),
        ((10, 1 / 24, [0.5 / 24]), 24, 0, 10),  # half a frame late
        ((72, 1 / 24, [0.75 / 24, 1 / 24, 1.25 / 24]), 24, 1, 24),  # motion blur
        ((48, 1 / 24, [1 / 24, 1.5 / 24]), 24, 1, 24),
        ((48, 1 / 24, [0.75 / 24, 1.25 / 24]), 24, 1, 24),
    ],
)
def test_the_frames_of_an_archive(tmp_path, sampling, fps, first, count):
    found = archive_frames(str(archive(tmp_path / "a.abc", sampling)))
    assert found.fps == pytest.approx(fps) and found.numbers.tolist() == list(range(first, first + count))
    offset = 0.5 if sampling[2] == [0.5 / 24] else 0
    np.testing.assert_allclose(found.seconds, (found.numbers + offset) / fps, atol=1e-9)
    assert found.source == "the archive's time sampling"
    assert bool(found.notes) == (len(sampling[2]) > 1)


def test_listed_times_become_frames_at_their_rate(tmp_path):
    times = (np.arange(20) / 30).tolist()
    path = archive(tmp_path / "a.abc", (20, ACYCLIC, times))
    found = archive_frames(str(path))
    assert found.fps == 30 and found.numbers.tolist() == list(range(20)) and found.source == "the spacing of its samples"
    path = archive(tmp_path / "b.abc", (3, ACYCLIC, [0.0, 0.3, 1.0]), metadata="FramesPerTimeUnit=24.000000;x=1")
    found = archive_frames(str(path))
    assert found.fps == 24 and len(found.numbers) == 25 and "FramesPerTimeUnit" in found.source


def test_what_contradicts_itself_is_said(tmp_path):
    sampling = (24, 1 / 24, [0.0])
    two = archive_frames(str(archive(tmp_path / "a.abc", sampling, (10, 1 / 60, [0.0]))))
    assert two.fps == 24 and "24, 60 frames a second" in two.notes[0]
    other = archive_frames(str(archive(tmp_path / "b.abc", sampling, metadata="FramesPerTimeUnit=30")))
    assert other.fps == 24 and "30 frames a second" in other.notes[0]
    slow = archive_frames(str(archive(tmp_path / "c.abc", (24, 1.0, [0.0]))))
    assert slow.fps == 0 and len(slow.numbers) == 24 and slow.seconds[-1] == 23 and "1 s apart" in slow.notes[0]


def test_damage_and_stills_have_no_times(tmp_path):
    whole = archive(tmp_path / "a.abc", (24, 1 / 24, [0.0])).read_bytes()
    assert archive_frames(str(archive(tmp_path / "still.abc"))) is None
    for name, sampling in {
        "count": (4_000_000_000, 1 / 24, [0.0]),
        "zero": (24, 0.0, [0.0]),
        "nan": (24, 1 / 24, [float("nan")]),
        "empty": (24, 1 / 24, []),
        "far": (24, 1 / 24, [1e300]),
        "fast": (24, 1e-12, [0.0]),
    }.items():
        assert archive_frames(str(archive(tmp_path / f"{name}.abc", sampling))) is None, name
    random, path = np.random.default_rng(0), tmp_path / "b.abc"
    for _ in range(400):
        content = bytearray(whole)
        place = int(random.integers(8, len(content)))
        content[place : place + 4] = random.integers(0, 256, 4, dtype=np.uint8).tobytes()
        path.write_bytes(content[: int(random.integers(9, len(content) + 1))] if random.uniform() < 0.3 else content)
        found = archive_frames(str(path))
        assert found is None or len(found.numbers) == len(found.seconds) <= 1_000_000
    assert archive_frames(str(tmp_path / "none.abc")) is None
