"""The folder of one run: names of its files, settings files of its processes, scenario of its manifest.

manifest.json summary.json events.jsonl      what runs or ran, results, events
flight.parquet radio.parquet ftm.parquet      truth and estimates, every frame, every ranging session
air.parquet                                   channel occupancy over time
receptions.parquet                            each frame at each station (radio.log_receptions)
sensors.parquet                               readings of the scenario's own sensors (sensors.extra)
radio.pcapng coflight_beacon.lua              capture of the channel, Wireshark's dissector of beacons
gains.parquet antenna.nec patterns.nc         antenna: gains over time, median instant as NEC deck, patterns
figures/*.png *.pdf                           figures, each in both formats
report.html                                   all of it on one page, for a browser, without a network
logs/*.log  config/*.json                     the processes' messages, their settings
guests.json                                   while a run with radio.guests flies: how programs join it
uav-0.ulg ...                                 ULog (logging.ulog, or a ground station), with ground truth
ground-0.tlog ...                             messages on the ground links (logging.tlog)
uav-0.params ...                              parameters that a ground station saved
raw/                                          binary logs, until the tables exist

Only the owner can read a run: its folder has mode 0700. A folder that exists, and is empty, keeps its rights;
what may hold secrets of the scenario, its settings and its command line, is private in it too: ``config``,
``raw`` and the manifest.
"""

import contextlib
import fcntl
import os
import shutil
import weakref
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Self

import msgspec
from msgspec import Struct

from autopilot.onboard.application import NO_APPLICATION, Layout
from autopilot.onboard.factory import dissectors_of, layout_of
from autopilot.parameters.config import RadioEndpoint
from foundation.records.private_files import FOLDER_MODE, PARENT_MODE, make_private, write_private
from foundation.records.record_log import BLOCK_ROWS
from foundation.records.whole_file import write_whole
from foundation.records.write_access import fault_of
from harness.scenario.scenario import Scenario
from harness.scenario.validation_errors import explain
from netsim.model.config import RadioPasswords, ServerConfig
from netsim.transport import guest_access


class PhysicsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the physics server."""

    run_id: str
    scenario: Scenario
    truth_log_path: str
    air_log_path: str
    event_log_path: str
    applications: Layout = NO_APPLICATION
    """What the on-board applications report."""
    sensor_log_path: str | None = None
    """None: the scenario has no sensors of its own."""
    log_block_rows: Annotated[int, msgspec.Meta(ge=1)] = BLOCK_ROWS
    """Rows that are written at once to the logs of truth, channel and sensors; 1 for logs that are read in
    flight."""
    connect_timeout_s: float = 120.0
    profile_from_us: int | None = None
    """Simulated time from which the process profiles itself; None: never."""


class _Completeness(Struct, frozen=True):
    """The part of the manifest that states whether there are results."""

    complete: bool = True
    """Manifests of earlier versions were written with the results."""


class _Applications(Struct, frozen=True):
    """The part of `PhysicsConfig` that tables depend on."""

    applications: Layout = NO_APPLICATION


NETWORK_FILE = "network.json"
"""Name of the file of the processes by which vehicles' network namespaces are entered."""
LISTED = 3
"""Entries of a folder that an error message names."""
NAME_ANOTHER = "name a new or an empty one with --out (in Python, out=)"


class FolderRefused(Exception):
    """The path cannot be the folder of a new run; the text is one line that says why."""


class RunFolder:
    """Paths of a run below ``path``; `create` makes the folders.

    The processes profile themselves from the simulated time ``profile_from_us`` on. ``live_records``: they
    write each record to the raw logs at once, for a program that reads them in flight.
    """

    def __init__(self, path: Path, *, profile_from_us: int | None = None, live_records: bool = False) -> None:
        self.path = path
        self.first_manifest: bytes | None = None
        """Content of the manifest that `create` writes."""
        self._profile_from_us = profile_from_us
        self.has_live_records = live_records
        self._log_block_rows = 1 if live_records else BLOCK_ROWS
        self._is_new = False
        """Whether `create` has made this run, and not another process at the same time."""
        self._made: list[Path] = []
        """Folders that `create` has made, the innermost first."""
        self._release: Callable[[], object] | None = None
        """Unlocks the raw logs, if this object holds them."""
        self.raw, self.config, self.logs, self.figures = (
            path / name for name in ("raw", "config", "logs", "figures")
        )
        self.manifest, self.summary = path / "manifest.json", path / "summary.json"
        self.events = path / "events.jsonl"
        self.flight, self.radio = path / "flight.parquet", path / "radio.parquet"
        self.ftm, self.air = path / "ftm.parquet", path / "air.parquet"
        self.gains, self.deck = path / "gains.parquet", path / "antenna.nec"
        self.patterns = path / "patterns.nc"
        self.page = path / "report.html"
        self.guest_access = path / guest_access.FILE
        self.network = path / NETWORK_FILE
        self.raw_truth, self.raw_air = self.raw / "truth.bin", self.raw / "air.bin"
        self.capture = path / "radio.pcapng"
        self.receptions, self.raw_receptions = path / "receptions.parquet", self.raw / "receptions.bin"
        self.sensors, self.raw_sensors = path / "sensors.parquet", self.raw / "sensors.bin"
        self.raw_frames, self.raw_sessions = self.raw / "frames.bin", self.raw / "sessions.bin"

    def create(self) -> Self:
        """Make the folders of a new run, which only their owner can read, and hold it; returns this object.

        Raises FolderRefused, before anything is written, unless the path is free or an empty folder of this
        user or root that no other can write; OSError if the manifest cannot be written.
        """
        try:
            names = names_in(self.path)
            if names:
                is_run = {self.config.name, self.logs.name} <= {*names}
                content = "a run already" if is_run else listed(names)
                raise FolderRefused(
                    f"{self.path.resolve()} holds {content}, and a run needs a folder of its own: "
                    f"{NAME_ANOTHER}"
                )
            self._made = [each for each in (self.path, *self.path.parents) if not each.exists()]
            make_private(self.path, exist_ok=True)
            fault = fault_of(self.path, self.path.stat())  # settings in it are code that the run executes
            if fault is not None:
                raise FolderRefused(f"{fault}, or {NAME_ANOTHER}")
            self.raw.mkdir(FOLDER_MODE)  # of two runs that begin at once, one fails here
            self._is_new = True
            self.config.mkdir(FOLDER_MODE)
            for part in (self.logs, self.figures):
                part.mkdir(PARENT_MODE)
        except OSError as error:
            raise FolderRefused(
                f"{self.path}: cannot be the folder of a run: {error.strerror}; {NAME_ANOTHER}"
            ) from None
        self._hold()
        if self.first_manifest is not None:
            self.write_manifest(self.first_manifest)
        return self

    def discard(self) -> None:
        """Delete what this object created, for a run whose flight has not begun."""
        self.release()
        if self._is_new:
            for path in list(self.path.glob("*")):  # all of the run: the folder was empty before
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
        for path in self._made:
            with contextlib.suppress(OSError):  # other runs may be in a parent meanwhile
                path.rmdir()

    def delete_tables(self) -> None:
        """Delete results that are not complete, and are made of the raw logs again."""
        radio = (self.radio, self.receptions, self.ftm, self.air)
        antenna = (self.gains, self.deck, self.patterns)
        for path in (self.summary, self.flight, self.sensors, *radio, *antenna):
            path.unlink(missing_ok=True)

    def is_reported(self) -> bool:
        """Return whether the run has its tables and summary. Raises OSError."""
        try:
            return msgspec.json.decode(self.manifest.read_bytes(), type=_Completeness).complete
        except (FileNotFoundError, NotADirectoryError):
            return False
        except msgspec.DecodeError:
            return True  # none that `read_scenario` accepts

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Hold the raw logs in the block, so that no other process deletes them. Raises NotARun."""
        was_held = self._release is not None
        if not self.raw.is_dir():
            raise NotARun(f"{self.path}: it has neither tables nor raw logs")
        if not was_held and not self._hold():
            raise NotARun(
                f"{self.path}: the run is in flight, or is held by the program that flew it; "
                f"use coflight report {self.path} when that program has ended"
            )
        try:
            yield
        finally:
            if not was_held:
                self.release()

    def _hold(self) -> bool:
        """Lock the raw logs until `release` or the end of the process; returns whether they were free."""
        descriptor = os.open(self.raw, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return False
        except OSError:
            pass  # a file system without locks
        self._release = weakref.finalize(self, os.close, descriptor)
        return True

    def release(self) -> None:
        """Unlock the raw logs; harmless when repeated."""
        if self._release is not None:
            self._release()
            self._release = None

    def write_manifest(self, content: bytes) -> None:
        """Replace the manifest, which only its owner can read. Raises OSError."""
        write_whole(self.manifest, content, private=True)

    def ulog(self, instance: int) -> Path:
        """Return the path of the ULog of one vehicle, which exists if it was asked for."""
        return self.path / f"uav-{instance}.ulg"

    def raw_vehicle(self, instance: int) -> Path:
        """Return the path of the binary log of one vehicle's estimates."""
        return self.raw / f"uav-{instance}.bin"

    def radio_config(
        self,
        scenario: Scenario,
        *,
        run_id: str,
        socket_path: str | None = None,
        passwords: RadioPasswords | None = None,
    ) -> ServerConfig:
        """Return the settings of the 802.11 emulator; its process without ``socket_path`` listens at TCP."""
        return ServerConfig(
            run_id=run_id,
            socket_path=socket_path,
            passwords=passwords,
            host=scenario.ports.host,
            port=scenario.ports.radio_tcp,
            stations=scenario.agents,
            seed=scenario.run.seed,
            packets=scenario.has_network,
            radio=scenario.channel,
            serial=scenario.serial_pairs,
            uwb=scenario.uwb_radios,
            frame_log_path=str(self.raw_frames),
            session_log_path=str(self.raw_sessions),
            reception_log_path=str(self.raw_receptions) if scenario.radio.log_receptions else None,
            log_block_rows=self._log_block_rows,
            capture_path=str(self.capture) if scenario.radio.capture else None,
            epoch_unix_us=scenario.run.epoch_unix_us,
            profile_from_us=self._profile_from_us,
        )

    def write_radio_config(self, scenario: Scenario, config: ServerConfig) -> Path:
        """Write the settings of the 802.11 emulator's process; returns the path.

        If it writes a capture, Wireshark's dissectors of the applications' datagrams are also written.
        """
        if scenario.radio.capture:
            for name, text in dissectors_of(scenario.onboard).items():
                (self.path / name).write_text(text, encoding="utf-8")
        return self.write_config("radio", config)

    def write_physics_config(self, scenario: Scenario, *, run_id: str) -> Path:
        """Write the settings of the physics server's process; returns the path."""
        config = PhysicsConfig(
            run_id=run_id,
            scenario=scenario,
            truth_log_path=str(self.raw_truth),
            air_log_path=str(self.raw_air),
            event_log_path=str(self.events),
            applications=layout_of(scenario.onboard),
            sensor_log_path=str(self.raw_sensors) if scenario.sensors.extra else None,
            log_block_rows=self._log_block_rows,
            profile_from_us=self._profile_from_us,
        )
        return self.write_config("physics", config)

    def write_vehicle_config(
        self,
        scenario: Scenario,
        instance: int,
        *,
        run_id: str,
        simulator_port: int,
        radio_endpoint: RadioEndpoint | None,
        companion_port: int | None = None,
    ) -> Path:
        """Write the settings of one UAV's process; returns the path.

        ``simulator_port`` is the simulator's actual TCP port, 0 if the process inherits its connection, and
        ``companion_port`` the UDP port to which the companion link sends, None: the scenario's.
        """
        config = scenario.vehicle_config(
            instance, run_id=run_id, radio_endpoint=radio_endpoint, log_path=str(self.raw_vehicle(instance))
        )
        ports = msgspec.structs.replace(config.ports, simulator_tcp=simulator_port)
        if companion_port is not None:
            ports = msgspec.structs.replace(ports, companion_remote_udp=companion_port)
        params_path = str(self.path / f"uav-{instance}.params")
        config = msgspec.structs.replace(
            config,
            ports=ports,
            params_path=params_path,
            log_block_rows=self._log_block_rows,
            profile_from_us=self._profile_from_us,
        )
        return self.write_config(f"uav-{instance}", config)

    def applications(self) -> Layout:
        """Return what the run's on-board applications report. Raises OSError and msgspec.DecodeError."""
        settings = (self.config / "physics.json").read_bytes()
        return msgspec.json.decode(settings, type=_Applications).applications

    def write_config(self, name: str, config: msgspec.Struct) -> Path:
        """Write the settings of a process, which only the user may read; returns the path."""
        path = self.config / f"{name}.json"
        write_private(path, msgspec.json.format(msgspec.json.encode(config), indent=2))
        return path


def names_in(folder: Path) -> list[str]:
    """Return the sorted names in a folder; none if it does not exist. Raises OSError."""
    try:
        return sorted(path.name for path in folder.iterdir())
    except FileNotFoundError:
        return []


def listed(names: Sequence[str]) -> str:
    """Return some names as text."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return f"{', '.join(names[:LISTED])}{more}"


class NotARun(Exception):
    """A folder does not hold a run that can be read; the text is one line that says why."""


class _Recorded(msgspec.Struct, frozen=True, kw_only=True):
    scenario: Scenario


def read_scenario(folder: RunFolder) -> Scenario:
    """Return the scenario that a run flew, with all overrides. Raises NotARun."""
    if not folder.is_reported() and folder.manifest.exists():
        raise NotARun(
            f"{folder.path}: its flight has no tables yet; coflight report {folder.path} makes them"
        )
    return _scenario_in(folder.manifest, f"{folder.path}: no run that has ended: it has no manifest.json")


def read_raw_scenario(folder: RunFolder) -> Scenario:
    """Return the scenario of a run that has raw logs, as `read_scenario`."""
    path = folder.config / "physics.json"
    return _scenario_in(path, f"{folder.path}: its flight has not begun: it has no config/physics.json")


def _scenario_in(path: Path, missing: str) -> Scenario:
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Recorded).scenario
    except (FileNotFoundError, NotADirectoryError):
        raise NotARun(missing) from None
    except msgspec.ValidationError as error:
        raise NotARun(f"{path}: of another version: {explain(error, {})}") from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{path}: not JSON: {error}") from None
