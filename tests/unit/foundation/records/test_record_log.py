"""Binary logs: whole blocks by row count, readable up to the last complete record after any failure."""

import numpy as np
import pytest

from foundation.records.record_log import (
    BLOCK_ROWS,
    RecordLog,
    count,
    cut_to_blocks,
    read,
    read_blocks,
    read_rows,
)
from netsim.emulator.log_layout import FRAME_LOG
from netsim.emulator.records import FrameRecord

PAIR = np.dtype([("time_us", "i8"), ("pos_ned_m", "f8", 3)])


def rows(number):
    return [(4000 * k, (k, 2.0 * k, -k)) for k in range(number)]


def test_appended_records_are_read_back(tmp_path):
    log = RecordLog(tmp_path / "log.bin", PAIR)
    for row in rows(BLOCK_ROWS + 3):
        log.append([row])
    log.close()
    log.close()
    records = read(tmp_path / "log.bin", PAIR)
    assert records["time_us"].tolist() == [4000 * k for k in range(BLOCK_ROWS + 3)]
    assert records["pos_ned_m"][5].tolist() == [5.0, 10.0, -5.0]


def test_full_blocks_are_on_disk_before_the_log_is_closed(tmp_path):
    log = RecordLog(tmp_path / "log.bin", PAIR)
    log.append(rows(2 * BLOCK_ROWS + 1))
    assert len(read(tmp_path / "log.bin", PAIR)) == 2 * BLOCK_ROWS
    log.close()


def test_packed_rows_are_written_in_the_same_blocks(tmp_path):
    logs = [RecordLog(tmp_path / name, PAIR) for name in ("rows", "arrays")]
    for first in range(0, 3 * BLOCK_ROWS, 7):
        chunk = rows(first + 7)[first:]
        logs[0].append(chunk)
        logs[1].append_array(np.array(chunk, dtype=PAIR))
        sizes = [(tmp_path / name).stat().st_size for name in ("rows", "arrays")]
        assert sizes[0] == sizes[1] == (first + 7) // BLOCK_ROWS * BLOCK_ROWS * PAIR.itemsize
    for log in logs:
        log.close()
    assert (tmp_path / "rows").read_bytes() == (tmp_path / "arrays").read_bytes()


def test_a_log_of_single_rows_has_each_at_once_and_the_same_bytes_in_the_end(tmp_path):
    logs = [RecordLog(tmp_path / "live", PAIR, block_rows=1), RecordLog(tmp_path / "blocks", PAIR)]
    for k, row in enumerate(rows(BLOCK_ROWS + 3)):
        for log in logs:
            log.append([row])
        assert count(tmp_path / "live", PAIR) == k + 1
    for log in logs:
        log.close()
    assert (tmp_path / "live").read_bytes() == (tmp_path / "blocks").read_bytes()


@pytest.mark.parametrize(
    ("written", "left"), [(3, 0), (BLOCK_ROWS, BLOCK_ROWS), (BLOCK_ROWS + 3, BLOCK_ROWS)]
)
def test_a_log_cut_to_blocks_is_that_of_a_killed_process(tmp_path, written, left):
    path = tmp_path / "log.bin"
    cut_to_blocks(path, PAIR)
    log = RecordLog(path, PAIR, block_rows=1)
    log.append(rows(written))
    cut_to_blocks(path, PAIR)
    assert count(path, PAIR) == left
    log.close()


def test_incomplete_record_is_ignored_and_a_missing_file_is_empty(tmp_path):
    log = RecordLog(tmp_path / "log.bin", PAIR)
    log.append(rows(3))
    log.close()
    whole = (tmp_path / "log.bin").read_bytes()
    (tmp_path / "log.bin").write_bytes(whole[:-1])
    assert len(read(tmp_path / "log.bin", PAIR)) == 2
    assert len(read(tmp_path / "none.bin", PAIR)) == 0


def test_log_is_closed_after_a_write_error():
    """A full disk is reported once, and the file is closed."""
    log = RecordLog("/dev/full", PAIR)
    log.append(rows(3))
    with pytest.raises(OSError, match="No space left"):
        log.close()
    log.close()
    assert log._file.closed


def test_frame_log_layout_matches_the_frame_records():
    assert FRAME_LOG.names == FrameRecord._fields


def test_blocks_of_a_log_are_its_complete_records(tmp_path):
    dtype = np.dtype([("time_us", "i8"), ("value", "f4")])
    rows = np.zeros(10, dtype)
    rows["time_us"] = np.arange(10)
    path = tmp_path / "log.bin"
    assert count(path, dtype) == 0
    assert list(read_blocks(path, dtype)) == []
    path.write_bytes(rows.tobytes() + b"cut")
    assert count(path, dtype) == 10
    for at_once in (1, 3, 10, 100):
        blocks = list(read_blocks(path, dtype, rows=at_once))
        assert max(map(len, blocks)) == min(at_once, 10)
        assert np.array_equal(np.concatenate(blocks), read(path, dtype))
    assert read_rows(path, dtype, 8, 5)["time_us"].tolist() == [8, 9]
    assert len(read_rows(path, dtype, 10, 5)) == 0
