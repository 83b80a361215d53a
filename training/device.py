"""Where networks are trained: on CUDA when there is one, else on one thread of the CPU."""

import os

import torch

from faultline.service.core.errors import InputError

CPU = torch.device("cpu")


def device_of(wanted: str | None) -> torch.device:
    """The device that is `wanted` ("cpu", "cuda"), or the best there is, set so that a seed gives the same bytes.

    Raises:
        InputError: no CUDA is there.
    """
    there = torch.cuda.is_available()
    if wanted == "cuda" and not there:
        raise InputError(
            "--device cuda: this build of torch finds no CUDA device; leave it out, or install torch for CUDA"
        )
    if wanted == "cpu" or not there:
        torch.set_num_threads(1)  # products are small: a second thread costs six times the CPU time and saves none
        return CPU
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # without it cuBLAS sums in any order
    torch.use_deterministic_algorithms(True)
    return torch.device("cuda")
