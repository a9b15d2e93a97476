"""Tensors in one block of memory of large pages: what is read again and again in whole, such as a network's weights."""

import mmap
from collections.abc import Sequence

import torch
from torch import Tensor

ALIGNMENT = 64  # bytes: a cache line
PAGE = 2 << 20  # bytes of a large page


def in_huge_pages(tensors: Sequence[Tensor]) -> list[Tensor]:
    """Copies of tensors on a CPU, contiguous, in one block of memory.

    The block is of large pages where the operating system has them (Linux): in pages of 4 kB a processor takes longer to find
    36 MB than to read them.
    """
    offsets, size = [], 0
    for tensor in tensors:
        offsets.append(size)
        size += -(-tensor.numel() * tensor.element_size() // ALIGNMENT) * ALIGNMENT
    block = _block(size)
    copies = []
    for tensor, offset in zip(tensors, offsets):
        part = block[offset : offset + tensor.numel() * tensor.element_size()].view(tensor.dtype).view(tensor.shape)
        copies.append(part.copy_(tensor.detach()))
    return copies


def _block(size: int) -> Tensor:
    """Memory `(byte,)` that begins at a large page."""
    advice = getattr(mmap, "MADV_HUGEPAGE", None)
    if advice is None or size < PAGE:
        return torch.empty(size, dtype=torch.uint8)
    memory = mmap.mmap(-1, size + 2 * PAGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(advice)
    block = torch.frombuffer(memory, dtype=torch.uint8)  # keeps the memory
    start = -block.data_ptr() % PAGE
    return block[start : start + size]
