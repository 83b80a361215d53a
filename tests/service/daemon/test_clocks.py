"""Clocks that are set, machines that sleep: with clocks that do as they are told."""

import pytest

from faultline.service.daemon.clocks import Clocks, Moved


class Kernel:
    monotonic, wall, boot = 100.0, 5000.0, 100.0

    def goes_on(self, seconds: float) -> None:
        self.monotonic += seconds
        self.wall += seconds
        self.boot += seconds


def made() -> tuple[Kernel, Clocks]:
    kernel = Kernel()
    return kernel, Clocks(lambda: kernel.monotonic, lambda: kernel.wall, lambda: kernel.boot)


def test_time_that_goes_on_is_no_news() -> None:
    kernel, clocks = made()
    for _ in range(100):
        kernel.goes_on(1.0)
        kernel.wall += 0.001  # trimmed
        assert clocks.look() == Moved(0.0, 0.0, 0.0)


@pytest.mark.parametrize("step", [3600.0, -3600.0])
def test_a_clock_that_is_set_is_told_once(step: float) -> None:
    kernel, clocks = made()
    kernel.goes_on(1.0)
    kernel.wall += step
    assert clocks.look() == Moved(step, 0.0, 0.0)
    kernel.goes_on(1.0)
    assert clocks.look() == Moved(0.0, 0.0, 0.0)


def test_a_sleep_is_no_step_of_the_wall_clock() -> None:
    kernel, clocks = made()
    kernel.wall += 600.0
    kernel.boot += 600.0
    assert clocks.look() == Moved(0.0, 600.0, 0.0)
    assert clocks.look() == Moved(0.0, 0.0, 0.0)


@pytest.mark.parametrize(("seconds", "stopped"), [(9.0, 0.0), (10.0, 10.0), (36000.0, 36000.0)])
def test_who_looks_again_after_long_was_stopped(seconds: float, stopped: float) -> None:
    kernel, clocks = made()
    kernel.goes_on(seconds)
    assert clocks.look() == Moved(0.0, 0.0, stopped)
    kernel.goes_on(1.0)
    assert clocks.look() == Moved(0.0, 0.0, 0.0)


def test_the_kernels_own_clocks_agree() -> None:
    assert Clocks().look() == Moved(0.0, 0.0, 0.0)
