"""``python -m foundation.processes.bound_program PARENT MODULE ...``: a module that ends with its parent.

The module runs as by ``python -m MODULE ...``, in a process that the kernel kills when its parent, of
process id PARENT, ends. This holds from before the module's imports on, which take seconds.
"""

import runpy
import sys

from foundation.processes.parent_death import end_with_parent_process


def main() -> None:
    """Bind this process to its parent and run the module."""
    parent, module, *arguments = sys.argv[1:]
    end_with_parent_process(int(parent))
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
