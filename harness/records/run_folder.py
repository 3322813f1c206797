"""The folder of one run: names of its files, settings files of its processes, scenario of its manifest.

manifest.json summary.json events.jsonl      what ran, results, events
flight.parquet radio.parquet ftm.parquet      truth and estimates, every frame, every ranging session
air.parquet                                   channel occupancy over time
receptions.parquet                            each frame at each station (radio.log_receptions)
radio.pcapng coflight_beacon.lua              capture of the channel, Wireshark's dissector of beacons
gains.parquet antenna.nec patterns.nc         antenna: gains over time, median instant as NEC deck, patterns
figures/*.png *.pdf                           figures, each in both formats
logs/*.log  config/*.json                     the processes' messages, their settings
uav-0.params uav-0.ulg ...                    parameters that a ground station saved, ULog
raw/                                          binary logs during the run
"""

from pathlib import Path

import msgspec
from msgspec import Struct

from harness.records import beacon_dissector
from harness.scenario.scenario import Scenario
from harness.scenario.validation_errors import explain
from netsim.model.config import ServerConfig


class PhysicsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the physics server."""

    run_id: str
    scenario: Scenario
    truth_log_path: str
    air_log_path: str
    event_log_path: str
    connect_timeout_s: float = 120.0
    profile_from_us: int | None = None
    """Simulated time from which the process profiles itself; None: never."""


class RunFolder:
    """Paths of a run below ``path``; `create` makes the folders.

    The processes profile themselves from the simulated time ``profile_from_us`` on.
    """

    def __init__(self, path: Path, *, profile_from_us: int | None = None) -> None:
        self.path = path
        self._profile_from_us = profile_from_us
        self.raw, self.config, self.logs, self.figures = (
            path / name for name in ("raw", "config", "logs", "figures")
        )
        self.manifest, self.summary = path / "manifest.json", path / "summary.json"
        self.events = path / "events.jsonl"
        self.flight, self.radio = path / "flight.parquet", path / "radio.parquet"
        self.ftm, self.air = path / "ftm.parquet", path / "air.parquet"
        self.gains, self.deck = path / "gains.parquet", path / "antenna.nec"
        self.patterns = path / "patterns.nc"
        self.raw_truth, self.raw_air = self.raw / "truth.bin", self.raw / "air.bin"
        self.capture = path / "radio.pcapng"
        self.receptions, self.raw_receptions = path / "receptions.parquet", self.raw / "receptions.bin"
        self.dissector = path / beacon_dissector.FILE_NAME
        self.raw_frames, self.raw_sessions = self.raw / "frames.bin", self.raw / "sessions.bin"

    @classmethod
    def create(cls, path: Path) -> "RunFolder":
        """Create the folder; raises FileExistsError if it contains a run, or another OSError."""
        folder = cls(path)
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(f"{path} is a file, and a run needs a folder")
        path.mkdir(parents=True, exist_ok=True)
        if folder.config.exists():
            raise FileExistsError(f"{path} holds a run already")
        for part in (folder.raw, folder.config, folder.logs, folder.figures):
            part.mkdir(parents=True, exist_ok=True)
        return folder

    def raw_vehicle(self, instance: int) -> Path:
        """Return the path of the binary log of one vehicle's estimates."""
        return self.raw / f"uav-{instance}.bin"

    def write_radio_config(self, scenario: Scenario, *, run_id: str) -> Path:
        """Write the settings of the 802.11 emulator's process; returns the path.

        If it writes a capture, Wireshark's dissector of beacons is also written.
        """
        if scenario.radio.capture:
            self.dissector.write_text(beacon_dissector.dissector(), encoding="utf-8")
        config = ServerConfig(
            run_id=run_id,
            host=scenario.ports.host,
            port=scenario.ports.radio_tcp,
            stations=scenario.agents,
            companions=tuple(filter(scenario.autopilot.is_px4, range(scenario.agents))),
            seed=scenario.run.seed,
            radio=scenario.radio,
            frame_log_path=str(self.raw_frames),
            session_log_path=str(self.raw_sessions),
            reception_log_path=str(self.raw_receptions) if scenario.radio.log_receptions else None,
            capture_path=str(self.capture) if scenario.radio.capture else None,
            epoch_unix_us=scenario.run.epoch_unix_us,
            profile_from_us=self._profile_from_us,
        )
        return self.write_config("radio", config)

    def write_physics_config(self, scenario: Scenario, *, run_id: str) -> Path:
        """Write the settings of the physics server's process; returns the path."""
        config = PhysicsConfig(
            run_id=run_id,
            scenario=scenario,
            truth_log_path=str(self.raw_truth),
            air_log_path=str(self.raw_air),
            event_log_path=str(self.events),
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
        radio_endpoint: str | None,
        simulator_unix: str | None = None,
    ) -> Path:
        """Write the settings of one UAV's process with the simulator's actual port; returns the path."""
        config = scenario.vehicle(
            instance, run_id=run_id, radio_endpoint=radio_endpoint, log_path=str(self.raw_vehicle(instance))
        )
        ports = msgspec.structs.replace(
            config.ports, simulator_tcp=simulator_port, simulator_unix=simulator_unix
        )
        params_path = str(self.path / f"uav-{instance}.params")
        config = msgspec.structs.replace(
            config, ports=ports, params_path=params_path, profile_from_us=self._profile_from_us
        )
        return self.write_config(f"uav-{instance}", config)

    def write_config(self, name: str, config: msgspec.Struct) -> Path:
        """Write the settings of a process; returns the path."""
        path = self.config / f"{name}.json"
        path.write_bytes(msgspec.json.format(msgspec.json.encode(config), indent=2))
        return path


class NotARun(Exception):
    """A folder does not hold a run that can be read; the text is one line that says why."""


class _Manifest(msgspec.Struct, frozen=True, kw_only=True):
    scenario: Scenario


def read_scenario(folder: RunFolder) -> Scenario:
    """Return the scenario that a run flew, with all overrides. Raises NotARun."""
    try:
        content = folder.manifest.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise NotARun(f"{folder.path}: no run that has ended: it has no manifest.json") from None
    try:
        return msgspec.json.decode(content, type=_Manifest).scenario
    except msgspec.ValidationError as error:
        raise NotARun(f"{folder.manifest}: of another version: {explain(error, {})}") from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{folder.manifest}: not JSON: {error}") from None
