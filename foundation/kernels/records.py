"""Records and tables of records in memory that compiled and plain Python code share, with named fields.

A record type is declared as a class with its fields as annotations. `record_dtype` makes the structured
dtype of it, so that kernels, Python code and type checkers use the same names. An array of such records is a
kernel's argument; ``array[0]`` is a record, in compiled code a plain pointer.

Tables with lengths that are only known at run time follow each other in one block of int64, which begins with
a header record. `opener` returns a function that opens the header of a block, `table` one that returns the
records of a table. In compiled code both are a few instructions, without any reference counting: the caller
of a compiled function holds the block until it returns, so a record must not outlive the call.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast, get_args, get_type_hints

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.base import BaseContext
from numba.core.typing.templates import Signature
from numba.extending import intrinsic
from numba.np.arrayobj import make_array
from numba.np.numpy_support import from_dtype
from numpy.typing import NDArray

Block = NDArray[np.int64]
Records = NDArray[np.void]
R = TypeVar("R")
Generate = Callable[..., ir.Value]
"""Generates the code of an intrinsic: (context, builder, signature, values)"""
_UNCOMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
_WORDS = {int: np.int64, bool: np.int64, float: np.float64}
_DTYPES: dict[type, np.dtype[np.void]] = {}


def record_dtype(record: type) -> np.dtype[np.void]:
    """Return the dtype of a record class: int and bool fields become int64, float fields float64.

    A field with several elements is annotated with ``Annotated[NDArray[...], shape]``, where the array's
    type is that of the elements; a field that is a record, with its class.

    There is one dtype for a class: Numba recognises an array by the identity of its dtype, but compares
    another one that is equal field by field, 5 us at each call of a kernel.
    """
    if record in _DTYPES:
        return _DTYPES[record]
    fields: list[tuple[Any, ...]] = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        if hint in _WORDS:
            fields.append((name, _WORDS[hint]))
        elif isinstance(hint, type):
            fields.append((name, record_dtype(hint)))
        else:
            array, shape = get_args(hint)
            fields.append((name, get_args(get_args(array)[1])[0], shape))
    return _DTYPES.setdefault(record, np.dtype((np.record, np.dtype(fields, align=True))))


def new_records(record: type, count: int = 1) -> Records:
    """Return an array (count,) of records, of zeros."""
    return np.zeros(count, record_dtype(record))


def new_record(record: type[R]) -> R:
    """Return a record of zeros."""
    return cast("R", new_records(record)[0])


def opener(record: type[R]) -> Callable[[Block], R]:
    """Return a function that returns the record at the beginning of a block."""
    dtype = record_dtype(record)
    if _UNCOMPILED:
        return lambda block: cast("R", block[: dtype.itemsize // 8].view(dtype)[0])
    opened = from_dtype(dtype)

    @intrinsic
    def first(_typing: object, block: types.Array) -> tuple[Any, Generate]:
        make: Any = make_array(block)  # type: ignore[no-untyped-call]

        def generate(
            context: BaseContext, builder: ir.IRBuilder, _: Signature, values: list[ir.Value]
        ) -> ir.Value:
            return _pointer(context, builder, make(context, builder, values[0]).data, opened)

        return opened(block), generate

    return cast("Callable[[Block], R]", first)


def table(begin: str, record: type[R], columns: str | None = None) -> Callable[..., R]:
    """Return a function that returns the record ``(header, row)`` or ``(header, row, column)`` of a table.

    ``begin`` names the header's field with the table's offset in bytes, ``columns`` the one with the length
    of a row.
    """
    dtype = record_dtype(record)
    if _UNCOMPILED:
        return _uncompiled(begin, dtype, columns)
    found, word = from_dtype(dtype), cgutils.intp_t

    def generate(
        context: BaseContext, builder: ir.IRBuilder, signature: Signature, values: list[ir.Value]
    ) -> ir.Value:
        header = builder.bitcast(values[0], cgutils.voidptr_t)

        def number(field: str) -> ir.Value:
            place = builder.gep(header, [word(signature.args[0].offset(field))])
            return builder.load(builder.bitcast(place, word.as_pointer()))

        row = values[1]
        if columns is not None:
            row = builder.add(builder.mul(row, number(columns)), values[2])
        offset = builder.add(number(begin), builder.mul(row, word(dtype.itemsize)))
        return _pointer(context, builder, builder.gep(header, [offset]), found)

    if columns is None:

        @intrinsic
        def record_of(_typing: object, header: types.Record, _row: types.Integer) -> tuple[Any, Generate]:
            return found(header, types.intp), generate

        return cast("Callable[..., R]", record_of)

    @intrinsic
    def record_at(
        _typing: object, header: types.Record, _row: types.Integer, _column: types.Integer
    ) -> tuple[Any, Generate]:
        return found(header, types.intp, types.intp), generate

    return cast("Callable[..., R]", record_at)


def _pointer(context: Any, builder: ir.IRBuilder, place: ir.Value, record: types.Type) -> ir.Value:  # noqa: ANN401
    """Return the place as Numba's representation of a record, which is its address."""
    return builder.bitcast(place, context.get_value_type(record))


def _uncompiled(begin: str, dtype: np.dtype[np.void], columns: str | None) -> Callable[..., Any]:
    def record_at(header: np.record, row: int, column: int = 0) -> object:
        view: Any = header.base
        if columns is not None:
            row = row * header[columns] + column
        return np.ndarray(1, dtype, view.base, header[begin] + row * dtype.itemsize)[0]

    return record_at
