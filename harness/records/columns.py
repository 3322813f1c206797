"""What the tables of a run and their columns mean: the text of docs/reference/tables.md and of the files.

`describe` adds it to a table as Arrow metadata, of the schema and of every field, with text as keys and
values. The metadata depend on the scenario only, so equal runs still give equal bytes. A changed text
changes ``log_sha256`` of every run.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC

import pyarrow as pa

from autopilot.commander.failsafe import Cause
from autopilot.logs.vehicle_record import NO_PHASE
from autopilot.mavlink.ardupilot_modes import COPTER_MODES
from autopilot.mavlink.modes import EXTERNAL_MODES, FlightMode
from autopilot.onboard.application import Layout
from foundation.unit_names import frame_of, unit_of
from harness.scenario.scenario import Scenario
from netsim.phy.modes import MODE_NAMES

FRAMES_TEXT = (
    "NED: north, east, down from the site's origin. FRD: forward, right, down of the vehicle's body. "
    "Quaternions (w, x, y, z) rotate FRD to NED."
)
_COMPONENTS = {"n": "north", "e": "east", "d": "down", "f": "forward", "r": "right"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column, or the columns of a vector; unit and frame are those that its name states, unless given."""

    description: str
    unit: str | None = None
    frame: str | None = None
    values: Mapping[str, str] = field(default_factory=dict)
    """Meanings by value, of an enumeration or of the bits of a set."""

    def unit_of(self, name: str) -> str:
        """Return the unit of the column, whose name is ``name``; empty without one.

        Of a dotted path, the last part that states a unit decides.
        """
        if self.unit is not None:
            return self.unit
        return next(filter(None, map(unit_of, reversed(name.split(".")))), "")

    def frame_of(self, name: str) -> str:
        """Return the frame of the column, whose name is ``name``; empty without one."""
        return frame_of(name) if self.frame is None else self.frame


@dataclass(frozen=True, slots=True, kw_only=True)
class TableKind:
    """A kind of table."""

    name: str
    """Name of the file without its suffix."""
    description: str
    row: str
    """What one row is."""
    columns: Mapping[str, Column]


def origin(scenario: Scenario) -> dict[str, str]:
    """Return the metadata that all tables of a run share: scenario, seed, origins of time and place."""
    site = scenario.site
    return {
        "scenario": scenario.name,
        "seed": str(scenario.run.seed),
        "time_origin_utc": scenario.run.epoch_utc.astimezone(UTC).isoformat(),
        "origin_latitude_deg": repr(site.latitude_deg),
        "origin_longitude_deg": repr(site.longitude_deg),
        "origin_altitude_m": repr(site.altitude_m),
        "frames": FRAMES_TEXT,
    }


def describe(table: pa.Table, kind: TableKind, about: Mapping[str, str]) -> pa.Table:
    """Return the table with the metadata of its kind and its fields; ``about`` is added to the schema's.

    Schema: ``table``, ``description``, ``row``. Field: ``description``, ``unit``, ``frame`` and ``values`` (a
    JSON object of meanings by value), each only where there is one. Raises KeyError for an unknown column.
    """
    fields = [each.with_metadata(_of_field(kind.columns, each.name)) for each in table.schema]
    metadata = {"table": kind.name, "description": kind.description, "row": kind.row, **about}
    return pa.Table.from_arrays(table.columns, schema=pa.schema(fields, metadata=metadata))


def _of_field(columns: Mapping[str, Column], name: str) -> dict[str, str]:
    vector, _, component = name.rpartition(".")
    if name in columns:
        column, text = columns[name], columns[name].description
    else:
        name, column = vector, columns[vector]
        text = f"{column.description} Component: {_COMPONENTS.get(component, component)}."
    values = json.dumps(column.values, ensure_ascii=False) if column.values else ""
    found = {"description": text, "unit": column.unit_of(name), "frame": column.frame_of(name)}
    return {key: value for key, value in (found | {"values": values}).items() if value}


def _in_words(name: str | None) -> str:
    return (name or "").lower().replace("_", " ")


def _mode_text(name: str) -> str:
    return f"VHT MCS {name[7:]}" if name.startswith("vht") else f"non-HT OFDM, {name[4:]} Mbit/s"


_TIME = Column(description="Simulated time.")
_NOT_LISTED = {FlightMode.DESCEND, *EXTERNAL_MODES}
"""Descend has the number of Land; the names of the external modes are the user's."""
_MODES = {
    **{str(number): mode.label for number, mode in COPTER_MODES.items()},
    **{str(mode.custom_mode): mode.label for mode in FlightMode if mode not in _NOT_LISTED},
}
_KINDS = {
    "data": "datagram", "rts": "request to send", "cts": "clear to send", "ack": "acknowledgement",
    "ftm_request": "request of a ranging session, or trigger of its burst", "ftm": "measurement frame",
}  # fmt: skip
_STATUSES = {
    "ok": "at least one round trip",
    "no_response": "the request was never acknowledged",
    "rejected": "the responder has no free session, or the peer is unknown, the station itself, or busy",
    "incapable": "the responder cannot measure in the requested format",
    "dropped": "the queue was full, the request expired in it, or the radio was switched off",
    "timeout": "no round trip in time",
    "lost": "at least one round trip, but the host lost the result",
}
"""As `netsim.ftm.session` describes them."""


def flight_kind(applications: Layout) -> TableKind:
    """Return the kind of ``flight.parquet`` in a run with these applications."""
    phases = {str(phase): name for phase, name in applications.phases.items()}
    return TableKind(
        name="flight",
        description="Truth, estimates and places; estimates are NaN where a vehicle has none.",
        row="a vehicle at a recorded instant (`run.record_rate_hz`)",
        columns={
            "time_us": _TIME,
            "uav": Column(description="Number of the vehicle, from 0."),
            "alive": Column(description="False once the process of the vehicle has ended or is given up."),
            "armed": Column(description="Whether the vehicle itself reports that its motors are armed."),
            "pos_ned_m": Column(description="True position."),
            "vel_ned_m_s": Column(description="True velocity over ground."),
            "q_ned_frd": Column(description="True attitude."),
            "omega_frd_rad_s": Column(description="True angular rate."),
            "wind_force_ned_n": Column(
                description="Force of the wind in the step before; 0 where the air moves instead."
            ),
            "wind_vel_ned_m_s": Column(
                description="Velocity of the air in the step before; 0 where the wind is a force."
            ),
            "rotor_speed_rad_s": Column(description="Speed of each rotor."),
            "mode": Column(description="The autopilot's custom mode: PX4's, or ArduPilot's.", values=_MODES),
            "phase": Column(
                description="Phase of the on-board application.",
                values=phases | {str(NO_PHASE): "no application"},
            ),
            "landed": Column(description="Whether the land detector reports ground contact."),
            "failsafe": Column(description="Whether a failsafe is active."),
            "causes": Column(
                description="Causes of failsafes: the sum of these bits.",
                values={str(int(cause)): _in_words(cause.name) for cause in Cause},
            ),
            "battery_remaining": Column(description="Charge that is left, 0 to 1."),
            "estimator_pos_ned_m": Column(
                description="Position by the estimator; its height is that of the barometer above the start."
            ),
            "estimator_vel_ned_m_s": Column(description="Velocity by the estimator."),
            "estimator_q_ned_frd": Column(description="Attitude by the estimator."),
            "gps_pos_ned_m": Column(
                description="The last GPS fix, measured `sensors.gps.delay_s` before it arrived."
            ),
            "onboard_pos_ned_m": Column(
                description="Position by the localisation of the on-board application."
            ),
            "onboard_pos_std_m": Column(
                description="Standard deviation of it, by the application.", frame="NED"
            ),
            "correction_ned_m": Column(
                description="What the application subtracts from the estimator's position to get its own."
            ),
            "odometry_offset_ned_m": Column(
                description="The part of the correction that comes from ranging and from GPS of all UAVs."
            ),
            "setpoint_pos_ned_m": Column(description="Position setpoint; NaN on an axis without one."),
            "desired_pos_ned_m": Column(description="Place of the vehicle by the plan of the formation."),
            **{f"app_{name}": _number(name) for name in applications.values},
        },
    )


def _number(name: str) -> Column:
    return Column(description=f"Number `{name}` of the application's status; NaN: not reported.")


RADIO = TableKind(
    name="radio",
    description="Frames on the channel.",
    row="a frame; frames are in order of their ends",
    columns={
        "start_ns": Column(description="First sample at the antenna of the transmitter."),
        "end_ns": Column(description="End of the frame at the antenna of the transmitter."),
        "source": Column(description="Number of the transmitting station: vehicles from 0, then guests."),
        "destination": Column(description="Number of the receiving station; -1 for a group-addressed frame."),
        "kind": Column(description="Kind of frame.", values=_KINDS),
        "mode": Column(
            description="Transmission mode.",
            values={name: _mode_text(name) for name in MODE_NAMES},
        ),
        "bytes": Column(description="Length with MAC header and FCS.", unit="byte"),
        "seq": Column(
            description="Sequence number of the datagram or session; of a measurement frame its number "
            "within the session, from 1; 0 for a refusal, RTS, CTS and ACK."
        ),
        "delivered": Column(description="Intended receivers that received it."),
        "collided": Column(
            description="Intended receivers that lost it to other signals on the channel, or sent themselves."
        ),
        "lost_to_noise": Column(description="Intended receivers that lost it to noise."),
    },
)
RECEPTIONS = TableKind(
    name="receptions",
    description="Receptions of frames, with `radio.log_receptions` only.",
    row="a frame of radio.parquet at a station other than its transmitter, in the order of frame and station",
    columns={
        "frame": Column(description="Number of the frame's row in radio.parquet, from 0."),
        "start_ns": Column(
            description="First sample at the antenna of the transmitter, as in radio.parquet."
        ),
        "source": Column(description="Number of the transmitting station."),
        "receiver": Column(description="Number of the receiving station."),
        "rx_power_dbm": Column(
            description="Received power, with fading; -inf beyond 4.8 km (3.0 km at 2.4 GHz)."
        ),
        "sinr_db": Column(
            description="Least ratio during the frame of its power to noise and all signals of others; -inf "
            "without power, NaN on the ideal channel, which has no noise."
        ),
        "outcome": Column(
            description="Outcome as counted in radio.parquet.",
            values={
                "not_addressed": "not an intended receiver",
                "delivered": "an intended receiver received it",
                "collided": "an intended receiver lost it to other signals on the channel, or sent itself",
                "lost_to_noise": "an intended receiver lost it to noise, or to its distance",
                "radio_off": "the radio of the station is off",
            },
        ),
        "reception": Column(
            description="What the receiver did with it, addressed or not.",
            values={
                "received": "received without errors",
                "errors": "received with errors, by noise or other signals",
                "below_sensitivity": "weaker than `radio.cca_preamble_dbm`, or within 4 dB of the noise",
                "transmitting": "the station itself sent during the frame",
                "missed": "not detected among other signals, or given up or ignored for another frame",
                "radio_off": "the radio of the station is off",
            },
        ),
    },
)
SENSORS = TableKind(
    name="sensors",
    description="Readings of the scenario's own sensors (`sensors.extra`), if it has some.",
    row="a value of a reading, in the order of arrival, sensor and vehicle",
    columns={
        "time_us": Column(description="Simulated time at which the reading arrives."),
        "measured_us": Column(description="Simulated time that the reading belongs to."),
        "uav": Column(description="Number of the vehicle, from 0."),
        "sensor": Column(description="Name of the sensor (`sensors.extra.name`)."),
        "column": Column(description="Name of the value, which states its unit."),
        "value": Column(
            description="The value; NaN where the sensor had none.", unit="that of the name in `column`"
        ),
    },
)
FTM = TableKind(
    name="ftm",
    description="Results of ranging.",
    row="a ranging request",
    columns={
        "measured_ns": Column(description="Time that the distance belongs to."),
        "initiator": Column(description="Number of the station that measured."),
        "peer": Column(description="Number of the station to which the distance was measured."),
        "status": Column(description="How the request ended.", values=_STATUSES),
        "distance_m": Column(description="Measured distance."),
        "true_distance_m": Column(
            description="Mean true distance over the round trips used; without any, that at the end."
        ),
        "distance_std_m": Column(
            description="Standard deviation of the measured distance, as the radio states it."
        ),
        "round_trips": Column(description="Round trips that the distance is the mean of."),
        "rssi_dbm": Column(description="Received power of the measurement frames."),
    },
)
AIR = TableKind(
    name="air",
    description="Occupancy of the channel.",
    row="a recorded instant (`run.record_rate_hz`)",
    columns={
        "time_us": _TIME,
        "busy_ns": Column(
            description="Time since the start in which the channel carried at least one signal."
        ),
    },
)
_ANTENNA = "antenna: x broadside, y end fire, z up"
GAINS = TableKind(
    name="gains",
    description="Maximum gain of the antenna.",
    row="an instant in formation (`antenna.snapshot_rate_hz`)",
    columns={
        "time_us": _TIME,
        "max_gain_dbi": Column(description="Maximum gain over all directions; null without a pattern."),
        "max_theta_deg": Column(description="Angle of its direction from the z axis.", frame=_ANTENNA),
        "max_phi_deg": Column(
            description="Angle of its direction from the x axis towards the y axis.", frame=_ANTENNA
        ),
        "pointing_error_deg": Column(description="Angle between its direction and the y axis."),
        "missing": Column(description="Why there is no pattern; null where there is one."),
    },
)
