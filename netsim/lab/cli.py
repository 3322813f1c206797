"""Command line of the radio emulator without a flight; prints tables, or JSON with ``--json``.

Exit status: 0 success, 2 invalid input (one line on stderr), 130 interrupted by Ctrl-C.
"""

import sys
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import msgspec
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from foundation.exit_status import BAD_INPUT, FINE, INTERRUPTED
from foundation.system_error import in_words
from netsim.lab.broadcast import broadcast as run_broadcast
from netsim.lab.ranging import MeshResult, range_mesh, range_pair
from netsim.lab.saturation import UNLIMITED, saturate
from netsim.lab.uwb_ranging import uwb_range_mesh, uwb_range_pair
from netsim.model.config import BandwidthMhz, Mode, RadioConfig, ServerConfig
from netsim.phy.errors import packet_error_rate
from netsim.phy.frames import MAX_MSDU_BYTES, UDP_OVERHEAD_BYTES
from netsim.phy.modes import phy_mode
from netsim.uwb.config import UwbConfig, UwbMethod

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to stdout.")]
# A range with both limits also rejects values that are not finite.
Seed = Annotated[int, typer.Option(help="Seed of all random numbers.", min=0, max=2**63 - 1)]
Stations = Annotated[int, typer.Option(help="Number of stations that send.", min=1, max=1000)]
DEFAULT_HOST = "127.0.0.1"
MOST_BYTES = MAX_MSDU_BYTES - UDP_OVERHEAD_BYTES
"""Largest UDP payload of one frame; above the 1500-byte IP MTU, as the packets of Bianchi's paper."""
Payload = Annotated[int, typer.Option("--payload", help="UDP payload, bytes.", min=0, max=MOST_BYTES)]
Seconds = Annotated[float, typer.Option(help="Simulated seconds.", min=0.001, max=1e6)]
Width = Annotated[int, typer.Option(help="Channel width, MHz: 20, 40 or 80.")]
ModeName = Annotated[
    str | None, typer.Option(help="Mode: ofdm6 .. ofdm54, vht_mcs0 .. vht_mcs9.", metavar="MODE")
]


UwbMethodName = Annotated[
    str, typer.Option("--method", help="Two-way ranging: ss (single-sided) or ds (double-sided).")
]
UwbSettings = Annotated[
    Path | None, typer.Option(help="JSON file of settings, with the fields of [uwb].", metavar="JSON")
]


def _uwb(method: str, settings: Path | None) -> UwbConfig:
    if method not in get_args(UwbMethod):
        raise typer.BadParameter(f"--method {method}: expected ss or ds")
    config = UwbConfig()
    if settings is not None:
        try:
            config = msgspec.json.decode(settings.read_bytes(), type=UwbConfig)
        except ValueError as error:
            raise typer.BadParameter(f"{settings}: {error}") from None
    return msgspec.structs.replace(config, method=cast("UwbMethod", method))


def _mode(name: str) -> Mode:
    if name in get_args(Mode):
        return cast("Mode", name)
    raise typer.BadParameter(
        f"{name!r} is not a mode; use ofdm6, 9, 12, 18, 24, 36, 48, 54 or vht_mcs0 .. vht_mcs9"
    )


def _width(width: int) -> BandwidthMhz:
    if width in get_args(BandwidthMhz):
        return cast("BandwidthMhz", width)
    raise typer.BadParameter(f"{width}: the channel width must be 20, 40 or 80 MHz")


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
        int | None, typer.Option(help="Retries of a frame; unlimited by default.", min=0, max=UNLIMITED)
    ] = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Throughput of saturated stations that send to one sink: Bianchi's model, 802.11a."""
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
            help="Uniform delay of each datagram, seconds; < 0: constant random phases.", min=-1e4, max=1e4
        ),
    ] = 0.0,
    seconds: Seconds = 30.0,
    mode: ModeName = "ofdm6",
    rts: Annotated[
        bool, typer.Option("--rts", help="Send RTS and CTS before each broadcast, as the article.")
    ] = False,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Delivery and delay of periodic broadcasts of all stations on one tick."""
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
    snr_db: Annotated[
        float, typer.Option(help="Signal-to-noise ratio in the channel, dB.", min=-300, max=300)
    ],
    width: Width = 20,
    payload_bytes: Annotated[
        int, typer.Option("--bytes", help="Bytes of the frame.", min=1, max=65_535)
    ] = 1458,
    json: Json = False,
) -> None:
    """Packet error rate at one signal-to-noise ratio, without preamble errors."""
    phy = phy_mode(_mode(mode), _width(width))
    result = {"per": packet_error_rate(phy, payload_bytes, 10.0 ** (snr_db / 10.0))}
    _show(result, as_json=json, title=f"{mode}, {width} MHz, {payload_bytes} B at {snr_db:g} dB")


@app.command()
def ftm(
    *,
    distance: Annotated[
        float, typer.Option(help="Distance of the pair, metres.", min=0.0, max=4_000.0)
    ] = 10.0,
    width: Width = 80,
    sessions: Annotated[int, typer.Option(help="Sessions, one after the other.", min=1, max=1_000_000)] = 200,
    ftms_per_burst: Annotated[int, typer.Option(help="Measurement frames.", min=2, max=31)] = 8,
    bias: Annotated[
        float, typer.Option(help="Calibration offset of the pair, metres.", min=-1_000.0, max=1_000.0)
    ] = 0.0,
    mode: ModeName = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Fine Time Measurement between two stations."""
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
        float,
        typer.Option(help="Period in which each station ranges to all others, seconds.", min=1e-3, max=1e4),
    ] = 0.1,
    seconds: Seconds = 10.0,
    width: Width = 80,
    ftms_per_burst: Annotated[int, typer.Option(help="Measurement frames.", min=2, max=31)] = 8,
    mode: ModeName = None,
    figure: Annotated[
        Path | None, typer.Option(help="Plot completion and delay by number of stations.", metavar="PNG")
    ] = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Fine Time Measurement between all pairs; the table has rows from two stations to --stations."""

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
        from netsim.lab.figures import mesh_figure  # noqa: PLC0415  the import takes longer than most runs

        figure.parent.mkdir(parents=True, exist_ok=True)
        mesh_figure(results, period_s=period).savefig(figure, dpi=120)
    if json:
        _show(results[-1], as_json=True, title="")
        return
    table = Table(title=f"every station ranges to every other, every {period:g} s, {width} MHz")
    for name in (
        "stations", "sessions/s", "airtime needed", "completed", "round trips", "mean delay", "channel busy",
    ):  # fmt: skip
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
def uwb(
    *,
    distance: Annotated[
        float, typer.Option(help="Distance of the pair, metres.", min=0.0, max=4_000.0)
    ] = 10.0,
    exchanges: Annotated[
        int, typer.Option(help="Exchanges, one after the other.", min=1, max=1_000_000)
    ] = 200,
    method: UwbMethodName = "ds",
    settings: UwbSettings = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Two-way ranging by UWB between two stations."""
    result = uwb_range_pair(distance_m=distance, exchanges=exchanges, uwb=_uwb(method, settings), seed=seed)
    _show(result, as_json=json, title=f"{exchanges} exchanges ({method}) over {distance:g} m")


@app.command()
def uwb_mesh(
    *,
    stations: Annotated[int, typer.Option(help="Number of stations.", min=2, max=200)] = 8,
    period: Annotated[
        float,
        typer.Option(help="Period in which each station ranges to all others, seconds.", min=1e-3, max=1e4),
    ] = 0.1,
    seconds: Seconds = 10.0,
    each_pair_once: Annotated[
        bool, typer.Option("--each-pair-once", help="Only one end of each pair ranges to the other.")
    ] = False,
    method: UwbMethodName = "ds",
    access: Annotated[str, typer.Option(help="aloha or slots.")] = "slots",
    settings: UwbSettings = None,
    seed: Seed = 1,
    json: Json = False,
) -> None:
    """Two-way ranging by UWB between all pairs of stations."""
    if access not in ("aloha", "slots"):
        raise typer.BadParameter(f"--access {access}: expected aloha or slots")
    result = uwb_range_mesh(
        stations=stations,
        period_s=period,
        seconds=seconds,
        uwb=msgspec.structs.replace(_uwb(method, settings), access=access),
        each_pair_once=each_pair_once,
        seed=seed,
    )
    _show(result, as_json=json, title=f"{stations} stations range ({method}, {access}) every {period:g} s")


@app.command()
def serve(
    *,
    stations: Annotated[int, typer.Option(help="Number of stations, on a circle.", min=1, max=1000)] = 2,
    radius: Annotated[float, typer.Option(help="Radius of the circle, metres.", min=0.0, max=1e5)] = 15.0,
    settings: Annotated[
        Path | None, typer.Option(help="JSON file of settings, with the fields of [radio].", metavar="JSON")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on, with --port.")] = DEFAULT_HOST,
    port: Annotated[
        int | None,
        typer.Option(
            help="TCP port to listen on; 0: any free port; without it a Unix socket of this user.",
            min=0,
            max=65_535,
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="Simulated time per wall time.", min=1e-3, max=1e6)] = 1.0,
    capture: Annotated[
        Path | None, typer.Option(help="Capture every frame to this file, for Wireshark.", metavar="PCAPNG")
    ] = None,
    seed: Seed = 1,
) -> None:
    """Run an emulator in real time for programs that join as stations s0, s1, ...

    Prints the folder that the programs pass to Guest; its guests.json has the endpoint and their passwords.
    Ctrl-C (status 130), SIGTERM (143) and SIGHUP (129) end it, and the folder is removed.
    """
    if port is None and host != DEFAULT_HOST:
        raise typer.BadParameter(f"--host {host} requires --port, a TCP port to listen on")
    from netsim.lab.serve import serve_in_real_time, with_guests  # noqa: PLC0415  only this command needs Zenoh

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
        port=port or 0,
        stations=0,
        seed=seed,
        radio=radio,
        capture_path=None if capture is None else str(capture),
    )
    serve_in_real_time(config, speed=speed, tcp=port is not None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except typer.TyperException as error:
        return _reject(error.format_message())
    except OSError as error:  # of a file, or of the transport, whose message is one line
        return _reject(in_words(error))
    except ValueError as error:  # invalid settings
        return _reject(" ".join(str(error).split()))
    except KeyboardInterrupt:
        return INTERRUPTED
    return status if isinstance(status, int) else FINE


def _reject(line: str) -> int:
    sys.stderr.write(f"coflight: {line}\n")
    return BAD_INPUT
