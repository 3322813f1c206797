"""Print the table of the autopilot's parameters, which is docs/reference/parameters.md."""

import os

from foundation.kernels import cache_folder

os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from autopilot.parameters.parameter_docs import markdown

if __name__ == "__main__":
    print(markdown(), end="")
