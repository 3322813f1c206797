"""Kernels of a package, kernels that its warm-up calls, and compiled signatures: for tests of warm-ups."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

from numba.core.dispatcher import Dispatcher

_CALLED_BY = """
import json, sys
from {module} import warm_up
called = set()
sys.setprofile(lambda frame, *_: called.add((frame.f_code.co_filename, frame.f_code.co_name)))
warm_up()
sys.setprofile(None)
print(json.dumps(sorted(called)))
"""


def kernels(folder: Path, *, without: str = "") -> set[tuple[str, str]]:
    """Return (file, name) of the kernels below a folder, except those in subfolders named ``without``."""
    return {
        (str(path), node.name)
        for path in folder.rglob("*.py")
        if path.parent.name != without
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.dump(each) for each in node.decorator_list)
    }


def called_by_rehearsal(module: str) -> set[tuple[str, str]]:
    """Return (file, name) of the functions that a module's ``warm_up`` calls, with the compiler off."""
    program = _CALLED_BY.format(module=module)
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=True)
    return {(file, name) for file, name in json.loads(done.stdout)}


def signatures(package: str, *, without: str = "") -> dict[str, list[object]]:
    """Return the compiled signatures of each kernel of a package, except those of a subpackage."""
    return {
        f"{kernel.__module__}.{kernel.__name__}": list(kernel.signatures)
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] == package and not (without and name.startswith(f"{package}.{without}"))
        for kernel in vars(module).values()
        if isinstance(kernel, Dispatcher)
    }
