"""Random damage and random nonsense: every bundle is refused in one line, or runs. A failure prints its seed."""

import json
import os
import random
from pathlib import Path
from typing import Any

import pytest
from made_bundle import GOLDEN, copied, put, refused, runs, write

SEEDS = int(os.environ.get("SEEDS", "200"))  # `make campaign-endurance` has more
INFINITE = "a number that JSON can write and no float can hold"
ODD: list[Any] = [0, -1, INFINITE, "", [], None, "x" * 100_000]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return copied(tmp_path)


def nonsense(raw: bytes, chance: random.Random) -> bytes:
    """The JSON text with one value, of any depth, replaced by an odd one."""
    top = json.loads(raw)
    node = top
    while True:
        place = chance.choice(list(node) if isinstance(node, dict) else range(len(node)))
        below = node[place]
        if not isinstance(below, (dict, list)) or not below or chance.random() < 0.05:
            node[place] = chance.choice(ODD)
            return json.dumps(top).replace(f'"{INFINITE}"', "1e999").encode()
        node = below


@pytest.mark.parametrize("name", sorted(path.name for path in GOLDEN.iterdir()))
def test_a_flipped_bit_anywhere_is_refused(bundle: Path, name: str) -> None:
    whole = (bundle / name).read_bytes()
    for seed in range(SEEDS):
        print("seed", seed)
        chance = random.Random(seed)  # noqa: S311
        content = bytearray(whole)
        for _ in range(chance.choice([1, 2, 10])):
            content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        if content != whole:
            (bundle / name).write_bytes(content)
            refused(bundle, "copy the bundle again from its source")


@pytest.mark.parametrize("name", sorted(path.name for path in GOLDEN.iterdir()))
def test_a_file_that_ends_early_is_refused(bundle: Path, name: str) -> None:
    whole = (bundle / name).read_bytes()
    for seed in range(SEEDS):
        print("seed", seed)
        (bundle / name).write_bytes(whole[: random.Random(seed).randrange(len(whole))])  # noqa: S311
        refused(bundle, "copy the bundle again from its source")


def test_nonsense_in_a_sealed_manifest_is_refused_or_runs(bundle: Path) -> None:
    whole = (bundle / "manifest.json").read_bytes()
    ran = 0
    for seed in range(SEEDS):
        print("seed", seed)
        write(bundle, nonsense(whole, random.Random(seed)))  # noqa: S311
        ran += runs(bundle)
    assert 0 < ran < SEEDS // 2  # an offset of 0 can be meant, most of the rest cannot


def test_nonsense_in_sealed_golden_vectors_is_refused_or_runs(bundle: Path) -> None:
    whole = (bundle / "golden.json").read_bytes()
    for seed in range(SEEDS // 4):
        print("seed", seed)
        put(bundle, "golden.json", nonsense(whole, random.Random(seed)))  # noqa: S311
        runs(bundle)


def test_flipped_bits_in_a_sealed_graph_are_refused_or_run(bundle: Path) -> None:
    """What computes something else is caught by the golden vectors; the last bits of a weight hardly show."""
    whole = (bundle / "ode.onnx").read_bytes()
    for seed in range(SEEDS // 4):
        print("seed", seed)
        chance = random.Random(seed)  # noqa: S311
        content = bytearray(whole)
        for _ in range(chance.choice([1, 2, 10])):
            content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        put(bundle, "ode.onnx", bytes(content))
        runs(bundle)
