"""A file of the results of jobs, to which each is appended when it ends: JSON lines.

A validation of hours can so be measured in pieces: a job whose result the file has is not run again.
"""

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
from msgspec import Struct

from studies.common.record_lines import RecordsError, append_record, read_records

_BEGIN = b'{"job":'
"""Begin of each line."""


class _Record(Struct, frozen=True, kw_only=True):
    job: str
    """Module and name of the function"""
    arguments: list[Any]
    commit: str
    result: msgspec.Raw


class JobRecords:
    """The results in a file, which is made if it does not exist.

    ``commit`` is stored with each new result. Raises RecordsError for a file that cannot be read and written,
    or has other content.
    """

    def __init__(self, path: Path, commit: str) -> None:
        self._path = path
        self._commit = commit
        self._records = {
            (record.job, _encoded(record.arguments)): record for record in read_records(path, _Record, _BEGIN)
        }

    def result(self, job: partial[Any]) -> Any:  # noqa: ANN401  what the job's function returns
        """Return the result of a job, None if the file has none.

        Raises RecordsError if it is of another type than the function's.
        """
        record = self._records.get((_name(job), _encoded(job.args)))
        if record is None:
            return None
        try:
            return msgspec.json.decode(record.result, type=get_type_hints(job.func)["return"])
        except msgspec.MsgspecError as error:
            raise RecordsError(f"{self._path}: result of {record.job}: {error}; give another file") from None

    def add(self, job: partial[Any], result: object) -> None:
        """Append the result of a job, and return when it is in the file. Raises OSError."""
        record = _Record(
            job=_name(job), arguments=list(job.args), commit=self._commit,
            result=msgspec.Raw(msgspec.json.encode(result)),
        )  # fmt: skip
        append_record(self._path, record)
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
