"""Command line for antenna patterns without a flight; prints tables, or JSON with ``--json``.

Exit status: 0 success, 2 invalid input (one line on stderr), 130 interrupted by Ctrl-C.
"""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from antenna.lab.formations import Disorder, formation
from antenna.model.config import AntennaConfig
from antenna.model.deck import DeckError, read_element
from antenna.model.geometry import ElementsTouch
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.parallel import WorkerError

FINE, BAD_INPUT, INTERRUPTED = 0, 2, 130
DECK_LIMIT_BYTES = 1_000_000

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to stdout.")]
Formation = Annotated[
    str,
    typer.Option(
        "--formation", help="Broadside columns x end-fire rows, such as 4x2.", metavar="COLUMNSxROWS"
    ),
]
Wavelength = Annotated[float, typer.Option(help="Wavelength, metres.", metavar="L")]
Broadside = Annotated[
    float, typer.Option(help="Spacing of columns, wavelengths.", min=0.0, max=1_000.0, metavar="LAMBDAS")
]
Endfire = Annotated[
    float, typer.Option(help="Spacing of rows, wavelengths.", min=0.0, max=1_000.0, metavar="LAMBDAS")
]
BackendName = Annotated[Literal["batch", "nec2", "nec2c"], typer.Option(help="Solver.")]
Sigma = Annotated[
    float,
    typer.Option(
        help="Standard deviation of positions along each axis, metres.", min=0.0, max=1e6, metavar="M"
    ),
]
Tilt = Annotated[
    float,
    typer.Option(
        help="Standard deviation of the tilt about each horizontal axis, degrees.",
        min=0.0,
        max=180.0,
        metavar="DEG",
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of all random numbers.", min=0, max=2**63 - 1)]
ElementKind = Annotated[
    Literal["dipole", "loop", "deck"] | None,
    typer.Option("--element", help="Kind of element; default dipole, with --deck deck."),
]
Length = Annotated[
    float | None, typer.Option(help="Dipole length or loop circumference, metres; default 0.05.", metavar="M")
]
Radius = Annotated[float | None, typer.Option(help="Wire radius, metres; default 0.0002.", metavar="M")]
Segments = Annotated[int | None, typer.Option(help="Segments of dipole or loop; default 9.", metavar="N")]
Deck = Annotated[
    Path | None, typer.Option(help="NEC deck with the wires of one element and its source.", metavar="FILE")
]
GroundKind = Annotated[
    Literal["none", "perfect", "real"], typer.Option(help="Kind of ground, level at height 0.")
]
Permittivity = Annotated[
    float | None, typer.Option(help="Relative permittivity of real ground; default 13.", metavar="EPS")
]
Conductivity = Annotated[
    float | None, typer.Option(help="Conductivity of real ground, S/m; default 0.005.", metavar="S")
]
Height = Annotated[
    float, typer.Option(help="Height of the formation above ground, metres.", min=0.0, max=1e6, metavar="M")
]
ExcitationKind = Annotated[
    Literal["end_fire", "hansen_woodyard", "optimum"], typer.Option(help="Feeding of the elements.")
]
FeedsFor = Annotated[
    Literal["places", "truth"],
    typer.Option("--feeds", help="Positions used for the feeds: nominal places, or those drawn."),
]
Grid = Annotated[float, typer.Option(help="Step of the pattern, degrees.", metavar="DEG")]
Cores = Annotated[int | None, typer.Option(help="Most cores to use; default all.", min=1, max=1_024)]
Netcdf = Annotated[Path | None, typer.Option(help="Write the patterns to a NetCDF-4 file.", metavar="FILE")]


def _option_of(field: str) -> str:
    """Return the name of the option that sets a field of `AntennaConfig`."""
    special = {"element_kind": "element", "grid_deg": "grid", "element_deck": "deck"}
    if field in special:
        return special[field]
    return field.removeprefix("element_").removeprefix("ground_").removesuffix("_s_m").removesuffix("_m")


def _config(*, deck: Path | None, **fields: object) -> AntennaConfig:
    """Return checked settings; None means the default. Raises ValueError with the name of the option."""
    given = {name: value for name, value in fields.items() if value is not None}
    _reject_without_effect(given, deck)
    if deck is not None:
        if given.setdefault("element_kind", "deck") != "deck":
            raise ValueError(f"--deck: {deck} needs --element deck, not {given['element_kind']}")
        given["element_deck"] = _deck_text(deck)
    elif given.get("element_kind") == "deck":
        raise ValueError("--element: deck requires a deck file, --deck FILE")
    try:
        return msgspec.convert(given, AntennaConfig)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).partition(" - at `$.")
        name, colon, rest = reason.partition(": ")
        if path:
            name = path.rstrip("`")
            raise ValueError(f"--{_option_of(name)}: {reason}, not {given[name]}") from None
        if colon and name in AntennaConfig.__struct_fields__:
            raise ValueError(f"--{_option_of(name)}: {rest}") from None
        raise


def _reject_without_effect(given: Mapping[str, object], deck: Path | None) -> None:
    """Raise ValueError for the first given option that has no effect."""
    if given.get("ground") != "real":
        for name in ("ground_permittivity", "ground_conductivity_s_m"):
            if name in given:
                raise ValueError(f"--{_option_of(name)}: only for real ground; expected --ground real")
    if deck is not None:
        for name in ("element_length_m", "element_radius_m", "segments"):
            if name in given:
                raise ValueError(f"--{_option_of(name)}: not allowed with --deck {deck}, which defines it")


def _deck_text(path: Path) -> str:
    with path.open("rb") as file:
        content = file.read(DECK_LIMIT_BYTES + 1)
    if len(content) > DECK_LIMIT_BYTES:
        raise ValueError(f"{path}: larger than {DECK_LIMIT_BYTES} bytes")
    text = content.decode("latin-1")
    try:
        read_element(text)
    except DeckError as error:
        raise ValueError(f"{path}: {error}") from None
    return text


@app.command()
def pattern(
    *,
    formation_text: Formation = "4x2",
    wavelength: Wavelength = 10.0,
    broadside: Broadside = 0.85,
    endfire: Endfire = 0.25,
    backend: BackendName = "batch",
    sigma: Sigma = 0.0,
    tilt: Tilt = 0.0,
    seed: Seed = 1,
    element: ElementKind = None,
    length: Length = None,
    radius: Radius = None,
    segments: Segments = None,
    deck: Deck = None,
    ground: GroundKind = "none",
    permittivity: Permittivity = None,
    conductivity: Conductivity = None,
    height: Height = 0.0,
    excitation: ExcitationKind = "end_fire",
    feeds: FeedsFor = "places",
    grid: Grid = 5.0,
    figure: Annotated[Path | None, typer.Option(help="Plot the pattern.", metavar="PNG")] = None,
    cuts: Annotated[Path | None, typer.Option(help="Plot its polar cuts.", metavar="PNG")] = None,
    deck_out: Annotated[
        Path | None, typer.Option(help="Write the array as a NEC deck.", metavar="FILE")
    ] = None,
    netcdf: Netcdf = None,
    json: Json = False,
) -> None:
    """Pattern of one formation: ideal, or random with --sigma or --tilt."""
    from antenna.lab.runs import Files, one_pattern  # noqa: PLC0415  compiles

    config = _config(
        deck=deck, wavelength_m=wavelength, element_kind=element, element_length_m=length,
        element_radius_m=radius, segments=segments, excitation=excitation, feeds_for=feeds, ground=ground,
        ground_permittivity=permittivity, ground_conductivity_s_m=conductivity, backend=backend,
        grid_deg=grid,
    )  # fmt: skip
    places_m = formation(
        formation_text, broadside_m=broadside * wavelength, endfire_m=endfire * wavelength, height_m=height
    )
    disorder = Disorder(sigma_m=sigma, tilt_rad=float(np.radians(tilt)), seed=seed)
    files = Files(figure=figure, cuts=cuts, deck=deck_out, netcdf=netcdf)
    result = one_pattern(places_m, config, disorder, files)
    _show(result, as_json=json, title=f"{formation_text}, wavelength {wavelength:g} m, {backend}")


@app.command()
def statistics(
    *,
    formation_text: Formation = "4x2",
    wavelength: Wavelength = 10.0,
    broadside: Broadside = 0.85,
    endfire: Endfire = 0.25,
    backend: BackendName = "batch",
    sigma: Sigma = 0.0,
    tilt: Tilt = 0.0,
    samples: Annotated[int, typer.Option(help="Number of random formations.", min=1, max=10_000_000)] = 1000,
    seed: Seed = 1,
    element: ElementKind = None,
    length: Length = None,
    radius: Radius = None,
    segments: Segments = None,
    deck: Deck = None,
    ground: GroundKind = "none",
    permittivity: Permittivity = None,
    conductivity: Conductivity = None,
    height: Height = 0.0,
    excitation: ExcitationKind = "end_fire",
    feeds: FeedsFor = "places",
    grid: Grid = 5.0,
    cores: Cores = None,
    figure: Annotated[
        Path | None, typer.Option(help="Plot the density of the maximum gain.", metavar="PNG")
    ] = None,
    envelope: Annotated[
        Path | None, typer.Option(help="Plot mean and spread of the patterns.", metavar="PNG")
    ] = None,
    netcdf: Netcdf = None,
    json: Json = False,
) -> None:
    """Gain statistics of many formations, displaced and tilted at random."""
    from antenna.lab.runs import Files, many_patterns  # noqa: PLC0415  compiles

    config = _config(
        deck=deck, wavelength_m=wavelength, element_kind=element, element_length_m=length,
        element_radius_m=radius, segments=segments, excitation=excitation, feeds_for=feeds, ground=ground,
        ground_permittivity=permittivity, ground_conductivity_s_m=conductivity, backend=backend,
        grid_deg=grid,
    )  # fmt: skip
    places_m = formation(
        formation_text, broadside_m=broadside * wavelength, endfire_m=endfire * wavelength, height_m=height
    )
    disorder = Disorder(sigma_m=sigma, tilt_rad=float(np.radians(tilt)), seed=seed)
    files = Files(figure=figure, envelope=envelope, netcdf=netcdf)
    cores = cores or len(os.sched_getaffinity(0))
    result = many_patterns(places_m, config, disorder, samples=samples, cores=cores, files=files)
    title = f"{samples} x {formation_text}, wavelength {wavelength:g} m, sigma {sigma:g} m, tilt {tilt:g}°"
    _show(result, as_json=json, title=title)


@app.command()
def benchmark(
    *,
    seconds: Annotated[
        float, typer.Option(help="Approximate duration, seconds.", min=0.0, max=3_600.0)
    ] = 20.0,
    json: Json = False,
) -> None:
    """Speed of the batch solver and of NEC2 (PyNEC), on one core each, and on two cores."""
    from antenna.lab.benchmark import benchmark as measure  # noqa: PLC0415  compiles

    _show(measure(seconds), as_json=json, title="8 dipoles, 5° patterns with refined maximum; µs of one core")


def _show(result: msgspec.Struct, *, as_json: bool, title: str) -> None:
    values = msgspec.to_builtins(result, str_keys=True)
    if as_json:
        sys.stdout.write(msgspec.json.encode(values).decode() + "\n")
        return
    table = Table(title=title, show_header=False)
    for name, value in _rows(values):
        table.add_row(name, value)
    Console(highlight=False).print(table)


def _rows(values: dict[str, Any], under: str = "") -> list[tuple[str, str]]:
    rows = []
    for name, value in values.items():
        if isinstance(value, dict):
            rows += _rows(value, f"{under}{name} ")
        else:
            text = "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
            rows.append((under + name, text))
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except typer.TyperException as error:
        return _reject(error.format_message())
    except OSError as error:  # of a file
        return _reject(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except (BackendUnavailable, ElementsTouch, RuntimeError, WorkerError, subprocess.TimeoutExpired) as error:
        return _reject(" ".join(str(error).split()))
    except ValueError as error:  # invalid settings
        return _reject(" ".join(str(error).split()))
    except MemoryError as error:
        reason = " ".join(str(error).split()) or "allocation failed"
        return _reject(f"out of memory, a coarser --grid needs less: {reason}")
    except KeyboardInterrupt:
        return INTERRUPTED
    return status if isinstance(status, int) else FINE


def _reject(line: str) -> int:
    sys.stderr.write(f"coflight: {line}\n")
    return BAD_INPUT
