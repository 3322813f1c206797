"""A file of the results of jobs, to which each is appended when it ends: JSON lines.

A validation of hours can so be measured in pieces: a job whose result the file has is not run again.
"""

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
from msgspec import Struct

_BEGIN = b'{"job":'
"""Begin of each line."""


class _Record(Struct, frozen=True, kw_only=True):
    job: str
    """Module and name of the function"""
    arguments: list[Any]
    commit: str
    result: msgspec.Raw


class JobRecordsError(ValueError):
    """A file of records that cannot be read: one line."""


class JobRecords:
    """The results in a file, which is made if it does not exist.

    ``commit`` is stored with each new result. A last line that is half-written is cut off. Raises
    `JobRecordsError` for a file that cannot be read and written, or has other content.
    """

    def __init__(self, path: Path, commit: str) -> None:
        self._path = path
        self._commit = commit
        self._records: dict[tuple[str, bytes], _Record] = {}
        try:
            with path.open("a+b") as file:
                file.seek(0)
                *lines, rest = file.read().split(b"\n")
                for number, line in enumerate(lines, 1):
                    record = self._record(line, number)
                    self._records[record.job, _encoded(record.arguments)] = record
                if not _BEGIN.startswith(rest[: len(_BEGIN)]):
                    self._record(rest, len(lines) + 1)
                file.truncate(sum(len(line) + 1 for line in lines))
        except OSError as error:
            raise JobRecordsError(f"{path}: {error.strerror or error}") from None

    def _record(self, line: bytes, number: int) -> _Record:
        try:
            return msgspec.json.decode(line, type=_Record)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            text = f"{self._path}, line {number}: not the result of a job: {error}; give another file"
            raise JobRecordsError(text) from None

    def result(self, job: partial[Any]) -> Any:  # noqa: ANN401  what the job's function returns
        """Return the result of a job, None if the file has none.

        Raises JobRecordsError if it is of another type than the function's.
        """
        record = self._records.get((_name(job), _encoded(job.args)))
        if record is None:
            return None
        try:
            return msgspec.json.decode(record.result, type=get_type_hints(job.func)["return"])
        except msgspec.MsgspecError as error:
            raise JobRecordsError(
                f"{self._path}: result of {record.job}: {error}; give another file"
            ) from None

    def add(self, job: partial[Any], result: object) -> None:
        """Append the result of a job, and return when it is in the file. Raises OSError."""
        record = _Record(
            job=_name(job), arguments=list(job.args), commit=self._commit,
            result=msgspec.Raw(msgspec.json.encode(result)),
        )  # fmt: skip
        with self._path.open("ab") as file:
            file.write(msgspec.json.encode(record) + b"\n")
        self._records[record.job, _encoded(record.arguments)] = record

    def commits_of(self, jobs: Iterable[partial[Any]]) -> list[str]:
        """Return the commits of the results of some jobs, each once, in the order of the jobs."""
        keys = ((_name(job), _encoded(job.args)) for job in jobs)
        return list(dict.fromkeys(self._records[key].commit for key in keys if key in self._records))


def _name(job: partial[Any]) -> str:
    if job.keywords:
        raise ValueError(f"{job}: only arguments by position are recorded")
    return f"{job.func.__module__}.{job.func.__qualname__}"


def _encoded(arguments: object) -> bytes:
    return msgspec.json.encode(arguments)
