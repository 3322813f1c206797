"""The command line of the emulator alone: no flight, one number or table at a time, JSON on request.

Exit status: 0 fine, 2 bad input, which is one line on stderr, 130 broken off by Ctrl-C.
"""

import sys
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from netsim.lab.broadcast import broadcast as run_broadcast
from netsim.lab.ranging import MeshResult, range_mesh, range_pair
from netsim.lab.saturation import UNLIMITED, saturate
from netsim.model.config import BandwidthMhz, Mode, RadioConfig, ServerConfig
from netsim.phy.errors import packet_error_rate
from netsim.phy.frames import MAX_MSDU_BYTES, UDP_OVERHEAD_BYTES
from netsim.phy.modes import phy_mode

FINE, BAD_INPUT, INTERRUPTED = 0, 2, 130

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
# A range with both its ends refuses what is not finite.
Seed = Annotated[int, typer.Option(help="Seed of everything random.", min=0, max=2**63 - 1)]
Stations = Annotated[int, typer.Option(help="Number of stations that send.", min=1, max=1000)]
MOST_BYTES = MAX_MSDU_BYTES - UDP_OVERHEAD_BYTES
"""Of UDP in one frame; more than IP hands to a network of 1500 bytes, as Bianchi's packets are."""
Payload = Annotated[int, typer.Option("--payload", help="UDP payload, bytes.", min=0, max=MOST_BYTES)]
Seconds = Annotated[float, typer.Option(help="Simulated seconds.", min=0.001, max=1e6)]
Width = Annotated[int, typer.Option(help="Channel width, MHz: 20, 40 or 80.")]
ModeName = Annotated[
    str | None, typer.Option(help="Mode: ofdm6 .. ofdm54, vht_mcs0 .. vht_mcs9.", metavar="MODE")
]


def _mode(name: str) -> Mode:
    for mode in get_args(Mode):
        if mode == name:
            return mode  # type: ignore[no-any-return]
    raise typer.BadParameter(f"{name!r} is no mode: ofdm6, 9, 12, 18, 24, 36, 48, 54 or vht_mcs0 .. vht_mcs9")


def _width(width: int) -> BandwidthMhz:
    for each in get_args(BandwidthMhz):
        if each == width:
            return each  # type: ignore[no-any-return]
    raise typer.BadParameter(f"{width}: the channel is 20, 40 or 80 MHz wide")


def _show(result: msgspec.Struct | dict[str, Any], *, as_json: bool, title: str) -> None:
    values = result if isinstance(result, dict) else msgspec.to_builtins(result)
    if as_json:
        sys.stdout.write(msgspec.json.encode(values).decode() + "\n")
        return
    table = Table(title=title, show_header=False)
    for name, value in values.items():
        table.add_row(name, _cell(value))
    Console(highlight=False).print(table)


def _cell(value: object) -> str:
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


@app.command()
def saturation(
    *,
    stations: Stations = 10,
    rts: Annotated[bool, typer.Option("--rts", help="RTS and CTS before every frame.")] = False,
    rate_mbps: Annotated[int, typer.Option(help="6, 9, 12, 18, 24, 36, 48 or 54.")] = 6,
    payload: Payload = 1000,
    seconds: Seconds = 10.0,
    retry_limit: Annotated[
        int | None,
        typer.Option(help="Repetitions of a frame; without it none is given up.", min=0, max=UNLIMITED),
    ] = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Stations that always have something to send, to one sink: Bianchi's model, 802.11a."""
    result = saturate(
        stations=stations,
        rts=rts,
        mode=_mode(f"ofdm{rate_mbps}"),
        payload_bytes=payload,
        seconds=seconds,
        seed=seed,
        retry_limit=UNLIMITED if retry_limit is None else retry_limit,
    )
    _show(result, as_json=json, title=f"{stations} saturated stations, {rate_mbps} Mbit/s")


@app.command()
def broadcast(
    *,
    stations: Annotated[int, typer.Option(help="Number of stations.", min=2, max=1000)] = 8,
    payload: Payload = 300,
    period: Annotated[float, typer.Option(help="Seconds between two ticks.", min=1e-4, max=1e4)] = 0.1,
    jitter: Annotated[
        float,
        typer.Option(
            help="Each tick is delayed by uniform [0, this); below 0 a phase for good.", min=-1e4, max=1e4
        ),
    ] = 0.0,
    seconds: Seconds = 30.0,
    mode: ModeName = "ofdm6",
    rts: Annotated[bool, typer.Option("--rts", help="The article's RTS and CTS in front.")] = False,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Periodic broadcasts of all stations on one tick, without acknowledgement."""
    result = run_broadcast(
        stations=stations,
        payload_bytes=payload,
        period_s=period,
        jitter_s=jitter,
        seconds=seconds,
        mode=_mode(mode or "ofdm6"),
        rts=rts,
        seed=seed,
    )
    _show(result, as_json=json, title=f"{stations} stations broadcast every {period:g} s")


@app.command()
def per(
    *,
    mode: Annotated[str, typer.Option(help="ofdm6 .. ofdm54, vht_mcs0 .. vht_mcs9.", metavar="MODE")],
    snr_db: Annotated[float, typer.Option(help="Signal over noise in the channel, dB.", min=-300, max=300)],
    width: Width = 20,
    payload_bytes: Annotated[
        int, typer.Option("--bytes", help="Bytes of the frame.", min=1, max=65_535)
    ] = 1458,
    json: Json = False,
) -> None:
    """Probability that a frame is lost at one signal-to-noise ratio, its preamble not counted."""
    phy = phy_mode(_mode(mode), _width(width))
    result = {"per": packet_error_rate(phy, payload_bytes, 10.0 ** (snr_db / 10.0))}
    _show(result, as_json=json, title=f"{mode}, {width} MHz, {payload_bytes} B at {snr_db:g} dB")


@app.command()
def ftm(
    *,
    distance: Annotated[float, typer.Option(help="Between the two, metres.", min=0.0, max=4_000.0)] = 10.0,
    width: Width = 80,
    sessions: Annotated[int, typer.Option(help="One after the other.", min=1, max=1_000_000)] = 200,
    ftms_per_burst: Annotated[int, typer.Option(help="Measurement frames.", min=2, max=31)] = 8,
    bias: Annotated[
        float, typer.Option(help="Calibration offset of the pair, metres.", min=-1_000.0, max=1_000.0)
    ] = 0.0,
    mode: ModeName = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Fine Time Measurement of one pair."""
    result = range_pair(
        distance_m=distance,
        width_mhz=_width(width),
        sessions=sessions,
        ftms_per_burst=ftms_per_burst,
        bias_m=bias,
        mode=None if mode is None else _mode(mode),
        seed=seed,
    )
    _show(result, as_json=json, title=f"{sessions} sessions over {distance:g} m, {width} MHz")


@app.command()
def ftm_mesh(
    *,
    stations: Annotated[int, typer.Option(help="Number of stations.", min=2, max=200)] = 8,
    period: Annotated[
        float, typer.Option(help="Seconds in which each ranges to every other.", min=1e-3, max=1e4)
    ] = 0.1,
    seconds: Seconds = 10.0,
    width: Width = 80,
    ftms_per_burst: Annotated[int, typer.Option(help="Measurement frames.", min=2, max=31)] = 8,
    mode: ModeName = None,
    figure: Annotated[
        Path | None, typer.Option(help="Draw completion and delay by number of stations.", metavar="PNG")
    ] = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Fine Time Measurement of all pairs; the table goes from two stations up to that many."""

    def run(count: int) -> MeshResult:
        return range_mesh(
            stations=count,
            period_s=period,
            seconds=seconds,
            width_mhz=_width(width),
            ftms_per_burst=ftms_per_burst,
            mode=None if mode is None else _mode(mode),
            seed=seed,
        )

    if json and figure is None:
        _show(run(stations), as_json=True, title="")
        return
    console = Console(stderr=True)
    counts = [
        n for n in range(2, stations + 1) if n == stations or stations <= 12 or n % (stations // 8) == 0
    ]
    results = list(map(run, track(counts, console=console, description="ranging", transient=True)))
    if figure is not None:
        from netsim.lab.figures import mesh_figure  # noqa: PLC0415  slower to import than most runs

        figure.parent.mkdir(parents=True, exist_ok=True)
        mesh_figure(results, period_s=period).savefig(figure, dpi=120)
    if json:
        _show(results[-1], as_json=True, title="")
        return
    table = Table(title=f"every station ranges to every other, every {period:g} s, {width} MHz")
    for name in (
        "stations",
        "sessions/s",
        "airtime wanted",
        "completed",
        "round trips",
        "mean delay",
        "channel busy",
    ):
        table.add_column(name, justify="right")
    for result in results:
        table.add_row(
            str(result.stations),
            f"{result.stations * (result.stations - 1) / period:.0f}",
            f"{result.airtime_fraction:.1%}",
            f"{result.completed_fraction:.1%}",
            f"{result.round_trips_mean:.1f}",
            "-" if result.mean_delay_ms is None else f"{result.mean_delay_ms:.1f} ms",
            f"{result.busy_fraction:.1%}",
        )
    Console(highlight=False).print(table)


@app.command()
def serve(
    *,
    stations: Annotated[int, typer.Option(help="Number of stations, on a circle.", min=1, max=1000)] = 2,
    radius: Annotated[float, typer.Option(help="Of the circle, metres.", min=0.0, max=1e5)] = 15.0,
    settings: Annotated[
        Path | None, typer.Option(help="JSON file of settings, as a scenario's [radio].", metavar="JSON")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(help="TCP port to listen on; 0 is any free one.", min=0, max=65_535)
    ] = 7447,
    speed: Annotated[float, typer.Option(help="Simulated against wall time.", min=1e-3, max=1e6)] = 1.0,
    capture: Annotated[
        Path | None, typer.Option(help="Write every frame there, for Wireshark.", metavar="PCAPNG")
    ] = None,
    seed: Seed = 1,
) -> None:
    """An emulator that other programs join as stations s0, s1, ...: see docs/reference/radio-api.md."""
    from netsim.lab.serve import serve_in_real_time, with_guests  # noqa: PLC0415  nothing else needs Zenoh

    radio = RadioConfig()
    if settings is not None:
        try:
            radio = msgspec.json.decode(settings.read_bytes(), type=RadioConfig)
        except ValueError as error:
            raise typer.BadParameter(f"{settings}: {error}") from None
    if not radio.guests:
        radio = with_guests(radio, stations, radius)
    config = ServerConfig(
        run_id=f"lab-{uuid.uuid4().hex[:8]}",
        host=host,
        port=port,
        stations=0,
        seed=seed,
        radio=radio,
        capture_path=None if capture is None else str(capture),
    )
    serve_in_real_time(config, speed=speed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except typer.TyperException as error:
        return _refuse(error.format_message())
    except OSError as error:  # of a file, or of the transport, which says it in a line of its own
        return _refuse(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except ValueError as error:  # of settings, each alone or together
        return _refuse(" ".join(str(error).split()))
    except KeyboardInterrupt:
        return INTERRUPTED
    return status if isinstance(status, int) else FINE


def _refuse(line: str) -> int:
    sys.stderr.write(f"coflight: {line}\n")
    return BAD_INPUT
