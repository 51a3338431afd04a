"""Settings of the machine that training runs under. They change results in their last bits."""

from __future__ import annotations

import ctypes
import sys

import torch

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3


def configure() -> None:
    """Prepare this process for training: one thread, kept memory, the faster matrix products.

    One thread a process, since lockstep runs fill a core and processes fill the others.
    """
    torch.set_num_threads(1)
    _keep_freed_memory()
    _use_onednn_products()


def _keep_freed_memory() -> None:
    """Have glibc hand freed blocks to the next tensor instead of back to the system.

    The page faults of fresh megabytes cost more than the arithmetic that fills them.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return  # another C library: only slower
    mallopt(_M_MMAP_THRESHOLD, 32 * 2**20)
    mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
    mallopt(_M_TOP_PAD, 64 * 2**20)


def _use_onednn_products() -> None:
    """Let oneDNN do batched products where its arithmetic stays float32.

    torch asks it only when told that bfloat16 would do; a CPU without matrix units for bfloat16
    computes in float32 all the same, one with them really rounds. So the setting is tried, and
    taken back where the error says that it rounds.
    """
    matmul = getattr(torch.backends.mkldnn, "matmul", None)
    if matmul is None or not hasattr(matmul, "fp32_precision"):
        return
    before = matmul.fp32_precision
    matmul.fp32_precision = "bf16"
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(8, 64, 64, generator=generator) for _ in range(2))
    error = (torch.bmm(a, b) - torch.bmm(a.double(), b.double())).abs().max().item()
    if not error < 1e-4:
        matmul.fp32_precision = before
