"""Arrays that a compiled function borrows from its caller, without counting who refers to their memory.

Numba counts references to an array's memory, by an atomic instruction for every view that is made and another
for every one that is dropped. A row of `netsim.model.tables` is a view, and the air's events look at hundreds
of rows: counting took half of their time. But whoever calls a compiled function holds its arguments until it
returns, so in between nobody need own them.
"""

from collections.abc import Callable
from typing import TypeVar

from llvmlite import ir
from numba.core import types
from numba.core.base import BaseContext
from numba.core.typing.context import Context
from numba.core.typing.templates import Signature
from numba.extending import intrinsic, overload
from numba.np.arrayobj import make_array

A = TypeVar("A")


def borrowed(array: A) -> A:
    """Give the same array without its owner, for the time of the compiled function that was given it.

    Views of it have no owner either. Without the compiler it is the array itself.
    """
    return array


@overload(borrowed)
def _compiled(array: types.Array) -> Callable[[types.Array], types.Array]:  # noqa: ARG001
    def view(array: types.Array) -> types.Array:
        return _without_owner(array)  # type: ignore[call-arg,arg-type]  # Numba adds the first

    return view


@intrinsic
def _without_owner(_typing: Context, array: types.Array) -> tuple[Signature, Callable[..., ir.Value]]:
    """See numba.core.datamodel.models.ArrayModel: ``meminfo`` is what counts, ``parent`` Python's object."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, _signature: Signature, arguments: list[ir.Value]
    ) -> ir.Value:
        view = make_array(array)(context, builder, arguments[0])  # type: ignore[no-untyped-call]
        view.meminfo = ir.Constant(view.meminfo.type, None)
        view.parent = ir.Constant(view.parent.type, None)
        return view._getvalue()

    return array(array), generate
