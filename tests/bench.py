"""What a tick costs: `make bench`. Paired, interleaved, CPU time; medians and spread. Never a test.

The peer of the fused graph is what a straightforward exporter would ship: one session per residual generator.
"""

import io
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import load_model
from faultline.service.bundle.load import load_bundle
from faultline.service.bus.base import SO_TIMESTAMPNS
from faultline.service.bus.interface import Interface
from faultline.service.bus.reader import CLASSIC
from faultline.service.bus.socketcan import EFF_FLAG, SocketCan
from faultline.service.core.monitor import Monitor
from faultline.service.core.residuals.generators import Graph
from faultline.service.logs import open_log
from faultline.testbench.command import main as rig

GOLDEN = Path(__file__).parent / "golden"
ROUNDS, CALLS = 15, 400


def cost_us(call: Callable[[], object]) -> float:
    """CPU time of a call [us], mean over `CALLS`."""
    start = time.process_time()
    for _ in range(CALLS):
        call()
    return (time.process_time() - start) / CALLS * 1e6


def report(name: str, samples: list[float], unit: str = "us") -> None:
    """Median and range of a figure."""
    middle = statistics.median(samples)
    print(f"{name:<52}{middle:>9.1f} {unit}   [{min(samples):.1f} .. {max(samples):.1f}]")


def graphs() -> None:
    """Ten generators in one graph against ten sessions, interleaved."""
    bank = build_bank(load_model("uds"))
    z = np.array([[1.0e5, 1.0e6, 1.0e6, 22.0, 0.5]])
    x = bank.start(z[0])[None]
    fused = Graph(bank.graph())
    singles, first = [], 0
    for row, generator in enumerate(bank.generators):
        states = x[:, first : first + len(generator.states)]
        singles.append((Graph(bank.only([row]).graph()), states))
        first += len(generator.states)
    a: list[float] = []
    b: list[float] = []
    for _ in range(ROUNDS):
        a.append(cost_us(lambda: fused(z=z, x=x)))
        b.append(cost_us(lambda: [graph(z=z, x=states) for graph, states in singles]))
    report("ten generators, one fused graph, a sample", a)
    report("ten generators, ten sessions, a sample", b)
    report("ratio of the pairs", [theirs / ours for ours, theirs in zip(a, b, strict=True)], "x ")


def networks() -> None:
    """Ten generators as networks of five members beside the equations' graph, interleaved; hot, and after a flush.

    Untrained: what a step costs does not depend on the weights.
    """
    from faultline.training.bank import networks_of
    from faultline.training.layout import layout_of
    from faultline.training.loop import Training
    from faultline.training.recipe import DEFAULT
    from faultline.training.samples import load_samples

    model = load_model("uds")
    bank = build_bank(model)
    with tempfile.TemporaryDirectory() as folder:
        given = ["--cycle", "drive", "--kind", "instrumented", "--duration", "200", "--id", "bench", "--out", folder]
        with redirect_stdout(io.StringIO()):
            rig(["record", *given, "--truth", f"{folder}/truth"])
        samples = load_samples(model, bank.inputs, [Path(folder) / "bench"], lambda _: None)
    made = networks_of(Training(layout_of(model), samples, DEFAULT, 0), samples, 0)
    theirs, ours = Graph(bank.graph()), Graph(made.graph)
    z = samples.stretches[0].z[:1]
    states = sum(len(generator.states) for generator in made.description.generators)
    x = {theirs: bank.start(z[0])[None], ours: np.full((1, states), 1e6)}
    hot: dict[Graph, list[float]] = {theirs: [], ours: []}
    cold: dict[Graph, list[float]] = {theirs: [], ours: []}
    flush = np.zeros(16 * 2**20)
    for _ in range(ROUNDS):
        for graph in (theirs, ours):
            hot[graph].append(cost_us(partial(graph, z=z, x=x[graph])))
            flush += 1.0
            start = time.perf_counter()
            graph(z=z, x=x[graph])
            cold[graph].append((time.perf_counter() - start) * 1e6)
    report(f"ten networks of five members ({len(made.graph) / 1024:.0f} KiB), a sample", hot[ours])
    report("the equations' graph, a sample", hot[theirs])
    report("networks with cold caches, a sample", cold[ours])
    report("the equations' graph with cold caches, a sample", cold[theirs])
    report("resident memory that the networks' graph adds", [added_mib(made.graph, bank.graph(), states)], "MiB")


def added_mib(graph: bytes, other: bytes, states: int) -> float:
    """What a graph adds to a process that runs another one already."""
    code = (
        "import sys, numpy as np; from pathlib import Path\n"
        "from faultline.service.core.residuals.generators import Graph\n"
        "def rss(): return int(Path('/proc/self/statm').read_text().split()[1]) * 4096 / 2**20\n"
        "a = Graph(Path(sys.argv[1]).read_bytes()); before = rss(); b = Graph(Path(sys.argv[2]).read_bytes())\n"
        "for _ in range(100): b(z=np.ones((1, 5)), x=np.ones((1, int(sys.argv[3]))))\n"
        "print(rss() - before)"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, content in (("a", other), ("b", graph)):
            (Path(folder) / name).write_bytes(content)
        command = [sys.executable, "-c", code, f"{folder}/a", f"{folder}/b", str(states)]
        return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def monitor() -> None:
    """The whole core on the golden log: decoding, sampling, residuals, decision, events."""
    bundle, log = load_bundle(GOLDEN / "bundle"), open_log(GOLDEN / "log")
    frames = list(log.relative())
    ticks = int(log.duration_s / bundle.manifest.period_s)
    spent = []
    for _ in range(ROUNDS):
        core = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id)
        start = time.process_time()
        list(core.log(iter(frames)))
        spent.append((time.process_time() - start) / ticks * 1e6)
    report(f"whole core, a sample of {len(frames) / ticks:.0f} frames", spent)
    told: list[list[float]] = []
    for _ in range(ROUNDS):
        core, latest, took = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id), -1.0, []
        for t, can_id, extended, data in frames:
            due = core.next_tick_s
            begin = time.process_time()
            core.frame(t, can_id, extended, data)
            if due is not None and due < t and due > latest:  # at least one tick lay before it
                took.append((time.process_time() - begin) * 1e3)
                latest = due
        told.append(sorted(took))
    for name, part in (("median", 0.5), ("99th percentile", 0.99), ("longest", 1.0)):
        report(f"from a tick to its verdict, {name}", [each[int(part * (len(each) - 1))] for each in told], "ms")


def memory() -> None:
    """Peak resident memory of a process that diagnoses the golden log (VmHWM, without its parent's)."""
    code = (
        "import sys; from faultline.service.diagnose.command import main; main(sys.argv[1:]); "
        "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0])"
    )
    command = [sys.executable, "-c", code, str(GOLDEN / "log"), "--bundle", str(GOLDEN / "bundle")]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    report("diagnosing the golden log, peak resident memory", [int(done.stdout.split()[-1]) / 1024], "MiB")


def listener() -> None:
    """A relevant frame received and decoded, against python-can's SocketCAN bus and cantools.

    The frames are `struct can_frame` over UDP of this machine, with kernel stamps: a stand-in where there is no CAN,
    with the same system calls and bytes. The peer gets the frames that a filter lets through, as ours does.
    """
    import cantools.database
    from can.interfaces.socketcan import SocketcanBus
    from cantools.database.can import Database

    bundle, log = load_bundle(GOLDEN / "bundle"), open_log(GOLDEN / "log")
    database = cantools.database.load_string((GOLDEN / "log" / "uds.dbc").read_text(), "dbc")
    assert isinstance(database, Database)
    sent = [
        CLASSIC.pack(can_id | EFF_FLAG, len(data), data.ljust(8, b"\0"))
        for _, can_id, extended, data in log.relative()
        if extended and bundle.table.decode(can_id, True, data)
    ][:CALLS]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender, stamped() as mine, stamped() as theirs:
        own = SocketCan("lo", make=lambda *_: mine, look=lambda _: Interface(1, True, True, True), clock=lambda: 0.0)
        peer: Any = object.__new__(SocketcanBus)  # without its socket of a CAN interface
        peer.socket, peer.channel, peer._is_filtered, peer._is_shutdown = theirs, "bench", True, True

        def ours() -> int:
            found = 0
            while frames := own.receive():
                for frame in frames:
                    found += bool(bundle.table.decode(frame.can_id, frame.is_extended, frame.data))
            return found

        def peers() -> int:
            found = 0
            while (message := peer.recv(0.0)) is not None:
                found += bool(database.decode_message(message.arbitration_id, message.data, decode_choices=False))
            return found

        a: list[float] = []
        b: list[float] = []
        for turn in range(2 * ROUNDS):
            order = [(ours, mine, a), (peers, theirs, b)]
            for call, sock, spent in order if turn % 2 else order[::-1]:
                for content in sent:
                    sender.sendto(content, sock.getsockname())
                start = time.process_time()
                count = call()
                spent.append((time.process_time() - start) / len(sent) * 1e6)
                assert count == len(sent)
    report("a relevant frame received and decoded", a)
    report("the same by python-can and cantools", b)
    report(
        "ours in parts of theirs, of the pairs", [100.0 * mine / their for mine, their in zip(a, b, strict=True)], "% "
    )


def stamped() -> socket.socket:
    """A socket of this machine's whose messages have the kernel's stamp, as a CAN socket's have."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 * 2**20)
    sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    sock.setblocking(False)
    return sock


if __name__ == "__main__":
    graphs()
    networks()
    monitor()
    listener()
    memory()
