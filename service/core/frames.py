"""Data frames of a log as columns: the form in which readers give them to the core."""

from typing import Protocol

import numpy as np
import numpy.typing as npt


class Frames(Protocol):
    """N data frames in order of time [s]: `time`, `identifier` and `length` (N,), and `data` (N, W), 0 beyond it.

    `channel` (N,) is the index of the channel that they came on.
    """

    @property
    def time(self) -> npt.NDArray[np.float64]: ...  # noqa: D102
    @property
    def channel(self) -> npt.NDArray[np.uint8]: ...  # noqa: D102
    @property
    def identifier(self) -> npt.NDArray[np.uint32]: ...  # noqa: D102
    @property
    def is_extended(self) -> npt.NDArray[np.bool_]: ...  # noqa: D102
    @property
    def length(self) -> npt.NDArray[np.uint8]: ...  # noqa: D102
    @property
    def data(self) -> npt.NDArray[np.uint8]: ...  # noqa: D102
    def __len__(self) -> int: ...
