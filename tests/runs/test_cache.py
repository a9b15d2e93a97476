"""What takes long to build is kept, and built anew when its code, its data or the kept file are not what they were."""

import torch

from riginv.runs.cache import cache_folder, cached_tensors, code_key


def test_a_key_follows_every_file_of_code_and_the_data_that_it_names(tmp_path):
    (tmp_path / "part").mkdir()
    inside, single, other = tmp_path / "part/inside.py", tmp_path / "single.py", tmp_path / "other.py"
    for path in (inside, single, other):
        path.write_text("before")
    sources = [tmp_path / "part", single]
    first = code_key(sources, ["torch"])
    other.write_text("after")
    assert code_key(sources, ["torch"]) == first
    assert code_key(sources) != first
    for path in (inside, single):
        path.write_text("after")
        assert code_key(sources, ["torch"]) != first
        path.write_text("before")
    assert code_key(sources, ["torch"]) == first


def test_what_is_kept_is_not_built_again_unless_it_is_damaged(own_cache):
    built = []

    def build() -> dict[str, torch.Tensor]:
        built.append(1)
        return {"values": torch.arange(3)}

    for _ in range(2):
        assert cached_tensors("thing", "key", build)["values"].tolist() == [0, 1, 2]
    assert len(built) == 1
    cached_tensors("thing", "another", build)
    (file,) = cache_folder().glob("thing-key*")
    file.write_bytes(b"nothing of use")
    assert cached_tensors("thing", "key", build)["values"].tolist() == [0, 1, 2]
    assert len(built) == 3
