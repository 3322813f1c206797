"""Arrays without reference counting inside a compiled function.

Numba counts references to an array's memory with one atomic instruction for every view created and one for
every view dropped. A row of `netsim.model.tables` is a view, and each event accesses hundreds of rows:
counting took half of the time. The caller of a compiled function holds references to its arguments until the
function returns, so no further counting is needed meanwhile.
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
    """Return a view of an argument without an owner, valid until the compiled function returns.

    Views of it have no owner either. In uncompiled code it is the array itself.
    """
    return array


@overload(borrowed)
def _compiled(array: types.Array) -> Callable[[types.Array], types.Array]:  # noqa: ARG001
    def view(array: types.Array) -> types.Array:
        return _without_owner(array)  # type: ignore[call-arg,arg-type]  # Numba supplies the first argument

    return view


@intrinsic
def _without_owner(_typing: Context, array: types.Array) -> tuple[Signature, Callable[..., ir.Value]]:
    """Clear ``meminfo``, the reference count, and ``parent`` of numba.core.datamodel.models.ArrayModel."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, _signature: Signature, arguments: list[ir.Value]
    ) -> ir.Value:
        view = make_array(array)(context, builder, arguments[0])  # type: ignore[no-untyped-call]
        view.meminfo = ir.Constant(view.meminfo.type, None)
        view.parent = ir.Constant(view.parent.type, None)
        return view._getvalue()

    return array(array), generate
