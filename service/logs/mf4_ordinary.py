"""Ordinary MF4 logs without asammdf (`logs.mf4_tree`): their records to frames."""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from faultline.service.logs.batch import Batch, Bytes
from faultline.service.logs.mf4_frames import FEWEST, RECORDS, frames_of, in_order
from faultline.service.logs.mf4_tree import TRANSPOSED, Group, Piece, tree

_PIECE = 1 << 22  # bytes of records that are read at once where they are not compressed


class OrdinaryMf4:
    """An ordinary file. `bad`: (record, reason, count) of what cannot be read, once all was.

    Raises:
        OddError: it is none.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.bad: list[tuple[int, str, int]] = []
        self._start_s, self._groups = tree(path)

    def batches(self) -> Iterator[Batch]:
        """Yield all frames in order of time, with the file's numbers of channels."""
        most = max(FEWEST, RECORDS // max(1, len(self._groups)))
        yield from in_order([self._of(group, most) for group in self._groups])

    def _of(self, group: Group, most: int) -> Iterator[Batch]:
        count = max([group.records, *((piece.begin + piece.size) // group.size for piece in group.pieces)])
        if count > group.records:
            self.bad.append((group.records, f"the file says {group.records} records and has {count}", 1))
        there = 0
        for first, whole in self._records(group):
            if first > there:
                self.bad.append((there, "a block is damaged", first - there))
            records = whole[max(0, there - first) :]
            for begin in range(0, len(records), most):
                some = records[begin : begin + most]
                columns = {name: field.read(some) for name, field in group.fields.items()}
                yield frames_of(group.kind, columns, group.time.read(some) + self._start_s)
            there = max(there, first + len(whole))
        if there < count:
            self.bad.append((there, "its block is damaged, or not there", count - there))

    def _records(self, group: Group) -> Iterator[tuple[int, Bytes]]:
        """The number of a record, and those from it on (N, size), without those of damaged pieces."""
        at, rest = 0, b""  # how far the group's bytes are read, and what is there of a record
        with self._path.open("rb") as file:
            for piece in group.pieces:
                if piece.begin != at:
                    at, rest = piece.begin, b""
                for raw in _unpacked(file, piece):
                    lost = 0 if rest else -at % group.size  # of a record that began in a damaged piece
                    whole, begin = rest + raw[lost:], at + lost - len(rest)
                    count = len(whole) // group.size
                    if count:
                        yield begin // group.size, np.frombuffer(whole, np.uint8, count * group.size).reshape(count, -1)
                    at, rest = at + len(raw), whole[count * group.size :]


def _unpacked(file: IO[bytes], piece: Piece) -> Iterator[bytes]:
    """The bytes of a piece; those of one that is compressed only if all are right."""
    file.seek(piece.at)
    if piece.packing is None:
        left = piece.stored
        while left > 0 and (raw := file.read(min(left, _PIECE))):
            left -= len(raw)
            yield raw
        return
    try:
        unpack = zlib.decompressobj()
        raw = unpack.decompress(file.read(piece.stored), piece.size + 1)
    except zlib.error:
        return
    if unpack.eof and len(raw) == piece.size:
        yield _in_rows(raw, piece.columns) if piece.packing == TRANSPOSED else raw


def _in_rows(raw: bytes, columns: int) -> bytes:
    """Bytes that were written column by column; those that fill no row are at the end as they were."""
    rows = len(raw) // columns if columns else 0
    table = np.frombuffer(raw, np.uint8, rows * columns).reshape(columns, rows)
    return table.T.tobytes() + raw[rows * columns :]
