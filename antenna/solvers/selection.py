"""Selection of a solver by the settings."""

from antenna.model.config import AntennaConfig
from antenna.solvers.interface import Backend


def make_backend(config: AntennaConfig, *, threads: int = 1) -> Backend:
    """Return the backend selected by ``config``; ``threads`` is used by the batch solver.

    Raises `BackendUnavailable`: NEC2 needs PyNEC, nec2c the program of that name.
    """
    match config.backend:
        case "batch":
            from antenna.solvers.batch.solver import Batch  # noqa: PLC0415 - compiles on import of its kernels

            return Batch(config, threads=threads)
        case "nec2":
            from antenna.solvers.nec2 import Nec2  # noqa: PLC0415 - optional: imports PyNEC

            return Nec2(config)
        case "nec2c":
            from antenna.solvers.nec2c import Nec2c  # noqa: PLC0415 - starts a program

            return Nec2c(config)
