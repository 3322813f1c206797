"""Generate the table of `netsim.phy.vht_tables`: the rows of each mode, and the command line."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import count
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress

from netsim.model.config import Mode
from netsim.phy.modes import PhyMode, phy_mode
from netsim.phy.vht_tables import Row
from studies.link_tables.link_level import Link

FIRST_DB = -8.0
STEP_DB = 0.25
SHORT_BYTES = 32
LONG_BYTES = 1458
CERTAIN = 0.99
"""Loss of short frames below which the table begins."""
FEW = 0.1
"""Loss of short frames below which the following rows use long frames."""
HARDLY_ANY = 1e-3
"""Loss of long frames at which the table ends."""
ENOUGH = 200
"""Lost frames, and received frames, that end a row: the standard error of the hazard is 7 %."""
MOST_FRAMES = 20_000
PROBE_FRAMES = 1_000

tables_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def rows(mode: PhyMode, *, seed: int, enough: int = ENOUGH, most_frames: int = MOST_FRAMES) -> Iterator[Row]:
    """Simulate one mode over rising signal-to-noise ratios, from short frames to long ones.

    The random numbers of a row depend only on seed, mode and ratio.
    """
    index = get_args(Mode).index(mode.name)
    frame_bytes, begun = SHORT_BYTES, False
    for k in count():
        snr_db = FIRST_DB + k * STEP_DB
        snr_linear = 10.0 ** (snr_db / 10.0)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index, k)))
        link = Link(mode, frame_bytes)
        if not begun:
            begun = link.count(snr_linear, rng, frames=PROBE_FRAMES, enough=PROBE_FRAMES).rate < CERTAIN
            if not begun:
                continue
        counted = link.count(snr_linear, rng, frames=most_frames, enough=enough)
        yield snr_db, frame_bytes, counted.frames, counted.lost
        if frame_bytes == SHORT_BYTES and counted.rate < FEW:
            frame_bytes = LONG_BYTES
        elif frame_bytes == LONG_BYTES and counted.rate <= HARDLY_ANY:
            return


def _lines(name: Mode, seed: int) -> str:
    return "".join(f"{name},{','.join(map(str, row))}\n" for row in rows(phy_mode(name, 80), seed=seed))


@tables_app.command()
def link_tables(
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.", min=0)] = 1,
    jobs: Annotated[
        int, typer.Option(help="Modes simulated in parallel; does not change the result.", min=1)
    ] = 1,
    out: Annotated[Path | None, typer.Option(help="Table to write; stdout by default.")] = None,
) -> None:
    """Simulate links at bit level and write the VHT packet error tables; takes half an hour."""
    names = [name for name in get_args(Mode) if name.startswith("vht")]
    parts: dict[str, str] = {}
    with ProcessPoolExecutor(jobs) as pool, Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("simulating", total=len(names))
        futures = {pool.submit(_lines, name, seed): name for name in names}
        for future in as_completed(futures):
            parts[futures[future]] = future.result()
            progress.update(task, advance=1, description=f"simulated {futures[future]}")
    text = "mode,snr_db,frame_bytes,frames,lost\n" + "".join(parts[name] for name in names)
    if out is None:
        Console(highlight=False).out(text, end="")
    else:
        out.write_text(text)
