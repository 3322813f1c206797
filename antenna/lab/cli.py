"""Command line for antenna patterns without a flight; prints tables, or JSON with ``--json``.

Exit status: 0 success, 2 invalid input (one line on stderr), 130 interrupted by Ctrl-C.
"""

import functools
import inspect
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from antenna.lab.formations import Disorder, formation
from antenna.model.config import AntennaConfig
from antenna.model.deck import DeckError, read_element
from antenna.model.geometry import Array, ElementsTouch
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.parallel import WorkerError
from foundation.exit_status import BAD_INPUT, FINE, INTERRUPTED
from foundation.system_error import in_words

DECK_LIMIT_BYTES = 1_000_000

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to stdout.")]
Cores = Annotated[int | None, typer.Option(help="Most cores to use; default all.", min=1, max=1_024)]
Netcdf = Annotated[Path | None, typer.Option(help="Write the patterns to a NetCDF-4 file.", metavar="FILE")]
_FIELDS = {
    "wavelength": "wavelength_m", "backend": "backend", "element": "element_kind",
    "length": "element_length_m", "radius": "element_radius_m", "segments": "segments",
    "deck": "element_deck", "ground": "ground", "permittivity": "ground_permittivity",
    "conductivity": "ground_conductivity_s_m", "excitation": "excitation", "feeds": "feeds_for",
    "grid": "grid_deg",
}  # fmt: skip
"""Fields of `AntennaConfig` by the options that set them."""


class ArrayOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of all commands that solve arrays; None means the default of `AntennaConfig`."""

    formation_text: Annotated[str, typer.Option(
        "--formation", help="Broadside columns x end-fire rows, such as 4x2.", metavar="COLUMNSxROWS"
    )] = "4x2"  # fmt: skip
    wavelength: Annotated[float, typer.Option(help="Wavelength, metres.", metavar="L")] = 10.0
    broadside: Annotated[float, typer.Option(
        help="Spacing of columns, wavelengths.", min=0.0, max=1_000.0, metavar="LAMBDAS"
    )] = 0.85  # fmt: skip
    endfire: Annotated[float, typer.Option(
        help="Spacing of rows, wavelengths.", min=0.0, max=1_000.0, metavar="LAMBDAS"
    )] = 0.25  # fmt: skip
    backend: Annotated[Literal["batch", "nec2", "nec2c"], typer.Option(help="Solver.")] = "batch"
    sigma: Annotated[float, typer.Option(
        help="Standard deviation of positions along each axis, metres.", min=0.0, max=1e6, metavar="M"
    )] = 0.0  # fmt: skip
    tilt: Annotated[float, typer.Option(
        help="Standard deviation of the tilt about each horizontal axis, degrees.", min=0.0, max=180.0,
        metavar="DEG",
    )] = 0.0  # fmt: skip
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.", min=0, max=2**63 - 1)] = 1
    element: Annotated[Literal["dipole", "loop", "deck"] | None, typer.Option(
        help="Kind of element; default dipole, with --deck deck."
    )] = None  # fmt: skip
    length: Annotated[float | None, typer.Option(
        help="Dipole length or loop circumference, metres; default 0.05.", metavar="M"
    )] = None  # fmt: skip
    radius: Annotated[float | None, typer.Option(
        help="Wire radius, metres; default 0.0002.", metavar="M"
    )] = None  # fmt: skip
    segments: Annotated[int | None, typer.Option(
        help="Segments of dipole or loop; default 9.", metavar="N"
    )] = None  # fmt: skip
    deck: Annotated[Path | None, typer.Option(
        help="NEC deck with the wires of one element and its source.", metavar="FILE"
    )] = None  # fmt: skip
    ground: Annotated[Literal["none", "perfect", "real"], typer.Option(
        help="Kind of ground, level at height 0."
    )] = "none"  # fmt: skip
    permittivity: Annotated[float | None, typer.Option(
        help="Relative permittivity of real ground; default 13.", metavar="EPS"
    )] = None  # fmt: skip
    conductivity: Annotated[float | None, typer.Option(
        help="Conductivity of real ground, S/m; default 0.005.", metavar="S"
    )] = None  # fmt: skip
    height: Annotated[float, typer.Option(
        help="Height of the formation above ground, metres.", min=0.0, max=1e6, metavar="M"
    )] = 0.0  # fmt: skip
    excitation: Annotated[Literal["end_fire", "hansen_woodyard", "optimum"], typer.Option(
        help="Feeding of the elements."
    )] = "end_fire"  # fmt: skip
    feeds: Annotated[Literal["places", "truth"], typer.Option(
        help="Positions used for the feeds: nominal places, or those drawn."
    )] = "places"  # fmt: skip
    grid: Annotated[float, typer.Option(help="Step of the pattern, degrees.", metavar="DEG")] = 5.0

    def config(self) -> AntennaConfig:
        """Return checked settings; raises ValueError with the name of the option."""
        given = {name: value for name in _FIELDS if (value := getattr(self, name)) is not None}
        _reject_without_effect(given, self.deck)
        if self.deck is not None:
            if given.setdefault("element", "deck") != "deck":
                raise ValueError(f"--deck: {self.deck} needs --element deck, not {self.element}")
            given["deck"] = _deck_text(self.deck)
        elif self.element == "deck":
            raise ValueError("--element: deck requires a deck file, --deck FILE")
        try:
            return msgspec.convert({_FIELDS[name]: value for name, value in given.items()}, AntennaConfig)
        except msgspec.ValidationError as error:
            options = {field: name for name, field in _FIELDS.items()}
            reason, _, path = str(error).partition(" - at `$.")
            name, _, rest = reason.partition(": ")
            if path:
                option = options[path.rstrip("`")]
                raise ValueError(f"--{option}: {reason}, not {given[option]}") from None
            if name in options:
                raise ValueError(f"--{options[name]}: {rest}") from None
            raise

    def places_m(self) -> Array:
        """Return the places (n, 3); raises ValueError."""
        return formation(
            self.formation_text, broadside_m=self.broadside * self.wavelength,
            endfire_m=self.endfire * self.wavelength, height_m=self.height,
        )  # fmt: skip

    def disorder(self) -> Disorder:
        """Return the random errors of places and attitudes."""
        return Disorder(sigma_m=self.sigma, tilt_rad=float(np.radians(self.tilt)), seed=self.seed)


def _command(command: Callable[..., None]) -> None:
    """Add a command whose first parameter has all `ArrayOptions`, which precede its own options."""
    _, *own = inspect.signature(command).parameters.values()
    defaults = {field.name: field.default for field in msgspec.structs.fields(ArrayOptions)}
    types = get_type_hints(ArrayOptions, include_extras=True)
    shared = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=types[name])
        for name, default in defaults.items()
    ]

    @functools.wraps(command)
    def run(**options: object) -> None:
        array = msgspec.convert({name: options.pop(name) for name in defaults}, ArrayOptions)
        command(array, **options)

    vars(run)["__signature__"] = inspect.Signature([*shared, *own])
    app.command()(run)


def _reject_without_effect(given: Mapping[str, object], deck: Path | None) -> None:
    """Raise ValueError for the first given option that has no effect."""
    if given["ground"] != "real":
        for name in ("permittivity", "conductivity"):
            if name in given:
                raise ValueError(f"--{name}: only for real ground; expected --ground real")
    if deck is not None:
        for name in ("length", "radius", "segments"):
            if name in given:
                raise ValueError(f"--{name}: not allowed with --deck {deck}, which defines it")


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


@_command
def pattern(
    array: ArrayOptions,
    *,
    figure: Annotated[Path | None, typer.Option(help="Plot the pattern.", metavar="PNG")] = None,
    cuts: Annotated[Path | None, typer.Option(help="Plot its polar cuts.", metavar="PNG")] = None,
    deck_out: Annotated[Path | None, typer.Option(
        help="Write the array as a NEC deck.", metavar="FILE"
    )] = None,
    netcdf: Netcdf = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Pattern of one formation: ideal, or random with --sigma or --tilt."""
    from antenna.lab.runs import Files, one_pattern  # noqa: PLC0415  compiles

    config, files = array.config(), Files(figure=figure, cuts=cuts, deck=deck_out, netcdf=netcdf)
    result = one_pattern(array.places_m(), config, array.disorder(), files)
    title = f"{array.formation_text}, wavelength {array.wavelength:g} m, {array.backend}"
    _show(result, as_json=json, title=title)


@_command
def statistics(
    array: ArrayOptions,
    *,
    samples: Annotated[int, typer.Option(help="Number of random formations.", min=1, max=10_000_000)] = 1000,
    cores: Cores = None,
    figure: Annotated[Path | None, typer.Option(
        help="Plot the density of the maximum gain.", metavar="PNG"
    )] = None,
    envelope: Annotated[Path | None, typer.Option(
        help="Plot mean and spread of the patterns.", metavar="PNG"
    )] = None,
    netcdf: Netcdf = None,
    json: Json = False,
) -> None:  # fmt: skip
    """Gain statistics of many formations, displaced and tilted at random."""
    from antenna.lab.runs import Files, many_patterns  # noqa: PLC0415  compiles

    config, files = array.config(), Files(figure=figure, envelope=envelope, netcdf=netcdf)
    cores = cores or len(os.sched_getaffinity(0))
    result = many_patterns(
        array.places_m(), config, array.disorder(), samples=samples, cores=cores, files=files
    )
    title = (
        f"{samples} x {array.formation_text}, wavelength {array.wavelength:g} m, sigma {array.sigma:g} m,"
        f" tilt {array.tilt:g}°"
    )
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
        return _reject(in_words(error))
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
