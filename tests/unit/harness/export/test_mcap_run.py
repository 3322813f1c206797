"""A run as an MCAP file, read back by other code and compared with the run's tables (one flight of 8 s)."""

import json
from collections import Counter, defaultdict
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from paths import ROOT, SCENARIOS
from scipy.spatial.transform import Rotation

from foundation import exit_status
from foundation.geometry.geodesy import geodetic_to_ned
from harness.cli import export
from harness.export import enu, links, scene
from harness.export.messages import vectors
from harness.export.run_export import write_mcap
from harness.launch.one_process import OneProcessSwarm
from harness.records import pieces
from harness.records.run_folder import RunFolder, read_scenario
from harness.scenario.scenario_file import load
from netsim.emulator.log_layout import FRAME_LOG

AGENTS, LOST, HEXACOPTER = 4, 2, 1
SETTINGS = (
    f"agents={AGENTS}", "formation.columns=2", "formation.rows=2", "formation.height_m=2", "run.seed=7",
    "antenna.snapshot_rate_hz=4", "site.latitude_deg=50.5", "run.epoch_utc=2027-01-01T01:00:00+01:00",
    "radio.log_receptions=true", 'radio.guests=[{name="ground",pos_ned_m=[-5,3,-1.5]}]',
    'sensors.extra=[{model="range_finder"}]', f'vehicle.per_uav.{HEXACOPTER}.airframe="hexacopter"',
)  # fmt: skip
EPOCH_NS = 1_798_761_600 * 10**9  # 2027-01-01 00:00 UTC, by `date`
TAIL_NS = 40_000_000
"""Time by which a frame on the channel may end after the last instant."""
OF_TABLES = {
    "/radio/frames": "radio", "/radio/receptions": "receptions", "/radio/ranging": "ftm",
    "/radio/occupancy": "air", "/antenna/gain": "gains",
}  # fmt: skip
NED_TO_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_TO_FLU = np.diag([1, -1, -1])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A flight in which a vehicle is lost, its scenario, and its file."""
    path = tmp_path_factory.mktemp("flown")
    with OneProcessSwarm(load(SCENARIOS / "article.toml", SETTINGS), out=path) as swarm:
        swarm.run_until_formed(timeout_s=60)
        swarm.kill(LOST)
        swarm.run_for(1.0)
        swarm.summary(draw=False)
    folder = RunFolder(path)
    target = path.parent / f"{path.name}.mcap"
    assert export.main([str(path), "--mcap", str(target)]) == exit_status.FINE
    return SimpleNamespace(folder=folder, scenario=read_scenario(folder), file=target)


@pytest.fixture(scope="module")
def read(flown):
    """What a reader finds: schemas by topic, messages by topic, summary and metadata."""
    messages, schemas, order = defaultdict(list), {}, []
    with flown.file.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            schemas[channel.topic] = schema
            messages[channel.topic].append(message)
            order.append(message.log_time)
        decoded = defaultdict(list)
        protobuf = (t for t, schema in schemas.items() if schema.encoding == "protobuf")
        for _, channel, _, content in reader.iter_decoded_messages(topics=list(protobuf)):
            decoded[channel.topic].append(content)
    for topic, schema in schemas.items():
        if schema.encoding == "jsonschema":
            decoded[topic] = [json.loads(message.data) for message in messages[topic]]
    return SimpleNamespace(
        messages=messages, schemas=schemas, decoded=decoded, summary=summary, metadata=metadata, order=order
    )


@pytest.fixture(scope="module")
def flight(flown):
    return pq.read_table(flown.folder.flight).to_pandas()


def violations(value, schema, path="$"):
    """Yield what of a JSON value contradicts a schema of the keywords that the export uses."""
    known = {"$schema", "title", "description", "type", "properties", "required", "items"}
    assert set(schema) <= known, set(schema) - known
    kinds = {
        "object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "number": (int, float)
    }  # fmt: skip
    kind = schema["type"]
    is_bool = isinstance(value, bool)
    if not isinstance(value, kinds[kind]) or (is_bool and kind != "boolean"):
        yield f"{path}: {value!r} is no {kind}"
    elif kind == "object":
        yield from (f"{path}.{name} is missing" for name in schema.get("required", ()) if name not in value)
        for name, each in value.items():
            if name in schema["properties"]:
                yield from violations(each, schema["properties"][name], f"{path}.{name}")
            else:
                yield f"{path}.{name} is not in the schema"
    elif kind == "array":
        for k, each in enumerate(value):
            yield from violations(each, schema["items"], f"{path}[{k}]")


def test_json_messages_agree_with_their_schemas(read):
    topics = [topic for topic, schema in read.schemas.items() if schema.encoding == "jsonschema"]
    assert {"/uav0/state", "/uav0/sensors/range_finder", "/events", *OF_TABLES} <= set(topics)
    for topic in topics:
        schema = json.loads(read.schemas[topic].data)
        assert schema["title"] == read.schemas[topic].name
        found = [text for content in read.decoded[topic] for text in violations(content, schema)]
        assert not found, (topic, found[:3])


def test_schemas_have_one_type_a_field_as_viewers_require(read):
    def fields(schema):
        assert isinstance(schema["type"], str)
        assert schema["type"] != "null"
        for each in (*schema.get("properties", {}).values(), *filter(None, [schema.get("items")])):
            fields(each)

    for schema in read.summary.schemas.values():
        if schema.encoding == "jsonschema":
            fields(json.loads(schema.data))


def test_every_time_is_of_the_simulation(read, flight):
    first_ns = EPOCH_NS + int(flight["time_us"].min()) * 1_000
    last_ns = EPOCH_NS + int(flight["time_us"].max()) * 1_000
    assert first_ns <= min(read.order)
    assert max(read.order) <= last_ns + TAIL_NS
    for topic, messages in read.messages.items():
        assert all(message.publish_time == message.log_time for message in messages), topic
        for message, content in zip(messages, read.decoded[topic], strict=True):
            stamped = getattr(content, "entities", None) or getattr(content, "transforms", None) or [content]
            if not isinstance(content, dict):
                assert all(each.timestamp.ToNanoseconds() == message.log_time for each in stamped), topic


def test_messages_are_in_order(read):
    times_ns = np.array(read.order)
    assert np.all(np.diff(times_ns) >= 0)
    for messages in read.messages.values():
        assert [message.sequence for message in messages] == list(range(len(messages)))


def test_every_row_of_every_table_is_a_message(flown, read, flight):
    for topic, table in OF_TABLES.items():
        rows = pq.read_table(flown.folder.path / f"{table}.parquet").to_pylist()
        assert len(rows) == len(read.decoded[topic]) > 0, topic
        by_content = Counter(_canonical(row) for row in rows)
        derived = {"busy_fraction"}
        assert by_content == Counter(
            _canonical({k: v for k, v in content.items() if k not in derived})
            for content in read.decoded[topic]
        ), topic
    sensors = pq.read_table(flown.folder.sensors).to_pylist()
    finite = {
        (row["time_us"], row["uav"], row["column"]): row["value"]
        for row in sensors
        if np.isfinite(row["value"])
    }
    exported = {
        (content["time_us"], uav, column): value
        for uav in range(AGENTS)
        for content in read.decoded[f"/uav{uav}/sensors/range_finder"]
        for column, value in content.items()
        if column not in {"time_us", "measured_us"}
    }
    assert exported == finite
    assert len(flight) == sum(len(read.decoded[f"/uav{uav}/state"]) for uav in range(AGENTS))


def _canonical(row):
    kept = {
        k: v for k, v in row.items() if v is not None and not (isinstance(v, float) and not np.isfinite(v))
    }
    return json.dumps(kept, sort_keys=True)


def test_states_are_the_table_to_the_bit(read, flight):
    for uav in range(AGENTS):
        rows, states = flight[flight["uav"] == uav], read.decoded[f"/uav{uav}/state"]
        rotors = 6 if uav == HEXACOPTER else 4
        for column in flight.columns:
            if column == "uav":
                continue
            field, _, component = column.partition(".")
            values = rows[column].to_numpy()
            if field == "rotor_speed_rad_s":
                k = int(component)
                if k < rotors:
                    assert [state[field][k] for state in states] == values.tolist()
                else:
                    assert not values.any()
                continue
            found = [state.get(field, {}) if component else state.get(field) for state in states]
            found = [each.get(component) if component else each for each in found]
            for value, each in zip(values.tolist(), found, strict=True):
                assert each == (value if np.isfinite(value) else None), column
        assert {len(state["rotor_speed_rad_s"]) for state in states} == {rotors}
    assert {state["mode_name"] for state in read.decoded["/uav0/state"]} > {"Offboard"}
    assert "on station" in {state["phase_name"] for state in read.decoded["/uav0/state"]}


def test_poses_are_in_enu_and_flu(read, flight):
    """Independent of the product of quaternions in the export: matrices of scipy."""
    for uav in range(AGENTS):
        rows, poses = flight[flight["uav"] == uav], [each.pose for each in read.decoded[f"/uav{uav}/pose"]]
        enu_m = np.array([[p.position.x, p.position.y, p.position.z] for p in poses])
        ned_m = rows[[f"pos_ned_m.{k}" for k in "ned"]].to_numpy()
        assert np.array_equal(enu_m, ned_m @ NED_TO_ENU.T)
        q = np.array([[p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w] for p in poses])
        assert np.allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
        truth = Rotation.from_quat(rows[[f"q_ned_frd.{k}" for k in "xyzw"]].to_numpy()).as_matrix()
        expected = NED_TO_ENU @ truth @ FRD_TO_FLU.T
        assert np.allclose(Rotation.from_quat(q).as_matrix(), expected, atol=1e-12)


def numbers(message):
    """Return the values of a message's fields; the two topics have classes of their own for them."""
    return [value for _, value in message.ListFields()]


def test_frames_of_a_transform_are_those_of_the_poses(read):
    transforms = [each for message in read.decoded["/tf"] for each in message.transforms]
    assert {each.parent_frame_id for each in transforms} == {"site"}
    for uav in range(AGENTS):
        for topic, frame in (("pose", f"uav{uav}"), ("believed_pose", f"uav{uav}_believed")):
            of_frame = [each for each in transforms if each.child_frame_id == frame]
            poses = [each.pose for each in read.decoded[f"/uav{uav}/{topic}"]]
            assert poses
            assert [numbers(each.rotation) for each in of_frame] == [numbers(p.orientation) for p in poses]
            assert [numbers(each.translation) for each in of_frame] == [numbers(p.position) for p in poses]


def test_locations_give_the_positions_back(flown, read, flight):
    site = flown.scenario.site
    for uav in range(AGENTS):
        rows = flight[flight["uav"] == uav].set_index("time_us")
        for topic, column in (
            ("location", "pos_ned_m"), ("believed_location", "onboard_pos_ned_m"), ("gps", "gps_pos_ned_m"),
        ):  # fmt: skip
            fixes = read.decoded[f"/uav{uav}/{topic}"]
            assert len(fixes) > 5
            ned_m = geodetic_to_ned(
                [each.latitude for each in fixes], [each.longitude for each in fixes],
                [each.altitude for each in fixes], origin_lat_deg=site.latitude_deg,
                origin_lon_deg=site.longitude_deg, origin_alt_m=site.altitude_m,
            )  # fmt: skip
            times_us = [(each.timestamp.ToNanoseconds() - EPOCH_NS) // 1_000 for each in fixes]
            expected_m = rows.loc[times_us, [f"{column}.{k}" for k in "ned"]].to_numpy()
            assert np.allclose(ned_m, expected_m, atol=1e-5)
        believed = read.decoded[f"/uav{uav}/believed_location"][-1]
        at_us = (believed.timestamp.ToNanoseconds() - EPOCH_NS) // 1_000
        n, e, d = rows.loc[at_us, [f"onboard_pos_std_m.{k}" for k in "ned"]]
        assert np.allclose(np.diag(np.reshape(believed.position_covariance, (3, 3))), np.square([e, n, d]))


def test_formation_errors_have_the_rms_of_the_summary(flown, read):
    summary = json.loads(flown.folder.summary.read_text())["formation_rms_m"]
    contents = read.decoded["/formation/error"]
    alive = np.array([content["alive"] for content in contents])
    for name in ("absolute", "shape"):
        errors_m = np.array([content[f"{name}_m"] for content in contents])
        assert round(float(np.sqrt(np.mean(errors_m[alive] ** 2))), 4) == summary[name]
    assert not alive[-1, LOST]


def test_the_scene_has_vehicles_links_and_guests(flown, read):
    first, *_, last = read.decoded["/scene/vehicles"]
    entities = {entity.id: entity for entity in last.entities}
    assert set(entities) == {*(f"uav{uav}" for uav in range(AGENTS)), "guest ground"}
    for uav, airframe in enumerate(flown.scenario.airframes()):
        entity = entities[f"uav{uav}"]
        assert entity.frame_id == f"uav{uav}"
        assert entity.frame_locked
        hubs_flu_m = np.array([rotor.position_frd_m for rotor in airframe.rotors]) @ FRD_TO_FLU
        at = [[c.pose.position.x, c.pose.position.y, c.pose.position.z] for c in entity.cylinders]
        assert np.array_equal(at, hubs_flu_m)
    lost = {entity.id: entity.cubes[0].color for entity in first.entities}[f"uav{LOST}"]
    assert lost != entities[f"uav{LOST}"].cubes[0].color
    assert entities[f"uav{LOST}"].texts[0].text == f"uav{LOST} (lost)"
    primitives = [line for message in read.decoded["/scene/links"] for line in message.entities[0].lines]
    assert primitives
    assert all(max(line.indices) < len(line.points) and len(line.indices) % 2 == 0 for line in primitives)
    for message in read.decoded["/scene/links"]:
        assert message.entities[0].lifetime.ToTimedelta().total_seconds() == 0.5


def test_the_log_has_the_events_in_words(flown, read):
    lines = [(entry.name, entry.message) for entry in read.decoded["/log"]]
    assert ("swarm", "formation reached") in lines
    assert any(name == f"uav{LOST}" and text.startswith("lost: ") for name, text in lines)
    assert ("uav0", "mode Offboard") in lines
    assert ("uav0", "armed") in lines
    events = [json.loads(line) for line in flown.folder.events.read_text().splitlines()]
    expected = [{k: v for k, v in event.items() if v is not None} for event in events]
    assert read.decoded["/events"] == expected


def test_metadata_name_the_run(flown, read):
    summary = json.loads(flown.folder.summary.read_text())
    run = read.metadata["coflight.run"]
    assert run["log_sha256"] == summary["log_sha256"]
    assert (run["scenario"], run["seed"], run["origin_latitude_deg"]) == ("article", "7", "50.5")
    assert "version.coflight" in run
    assert read.metadata["coflight.summary"]["frames.sent"] == str(summary["frames"]["sent"])
    assert not {"wall_s", "real_time_factor"} & set(read.metadata["coflight.summary"])


def test_equal_runs_give_equal_files_that_only_the_owner_reads(flown, tmp_path):
    again = tmp_path / "again.mcap"
    manifest = json.loads(flown.folder.manifest.read_text())
    assert manifest["wall_s"] > 0
    write_mcap(flown.folder, again)
    assert again.read_bytes() == flown.file.read_bytes()
    assert again.stat().st_mode & 0o777 == 0o600


def test_the_page_lists_the_topics(read):
    page = (ROOT / "docs" / "how-to" / "mcap.md").read_text(encoding="utf-8")
    channels = {channel.topic: channel for channel in read.summary.channels.values()}
    for topic, channel in channels.items():
        name = topic.replace("range_finder", "NAME")
        for uav in range(AGENTS):
            name = name.replace(f"/uav{uav}/", "/uavN/")
        schema = read.summary.schemas[channel.schema_id].name
        row = next((line for line in page.splitlines() if line.startswith(f"| `{name}` |")), "")
        assert schema in row or name.startswith("/uavN/sensors/"), topic
        assert row, topic
        assert channel.metadata["description"].rstrip(".") in row, topic


def test_no_link_ends_at_a_lost_vehicle(flown):
    """The table of frames does not have the receivers of a frame to a group."""
    (last,) = (
        piece.flight[-1:]
        for piece in pieces.pieces_of_tables(flown.folder, flown.scenario, step_us=1_000_000_000)
    )
    table = links.LinkTable(AGENTS + 1)
    table.add_frames(frames({"end_ns": 1, "source": 0, "destination": -1, "kind": b"data", "delivered": 3}))
    drawn = scene.Scene(flown.scenario, epoch_ns=0).messages(last, np.ones(1, np.bool_), table)
    (entity,) = next(content for _, topic, content in drawn if topic == scene.LINKS)["entities"]
    points = [tuple(point.values()) for line in entity["lines"] for point in line["points"]]
    ends = [tuple(at.values()) for at in vectors(enu.enu_of_ned(last["pos_ned_m"][0]))]
    assert {*ends} - {ends[LOST]} <= {*points}
    assert ends[LOST] not in points


# ---- an export that fails


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_an_export_that_is_broken_off_leaves_the_old_file(flown, tmp_path, monkeypatch, capsys, error):
    target = tmp_path / "run.mcap"
    target.write_bytes(b"old")

    def fails(*_):
        raise error
        yield

    monkeypatch.setattr("harness.export.run_export.sensor_messages", fails)
    status = export.main([str(flown.folder.path), "--mcap", str(target)])
    is_full = isinstance(error, OSError)
    assert status == (exit_status.BAD_INPUT if is_full else exit_status.INTERRUPTED)
    assert (target.read_bytes(), [path.name for path in tmp_path.iterdir()]) == (b"old", ["run.mcap"])
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert ("run.mcap: No space left" in line) is is_full


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--mcap", "x.mcap", "--wide", "x.csv"), "one of --time"),
        (("--mcap", "x.mcap", "--out", "x.nec"), "--out"),
        (("--mcap", "x.bag"), "ends in .mcap"),
        (("--mcap", "folder.mcap"), "it is a folder"),
        (("--mcap", "nowhere/x.mcap"), "nowhere"),
    ],
)
def test_bad_input_is_one_line(flown, tmp_path, monkeypatch, capsys, options, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.mcap").mkdir()
    assert export.main([str(flown.folder.path), *options]) == exit_status.BAD_INPUT
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert words in line
    assert [path.name for path in tmp_path.iterdir()] == ["folder.mcap"]


def test_a_folder_that_is_no_run_is_named(tmp_path, capsys):
    assert (
        export.main([str(tmp_path / "nowhere"), "--mcap", str(tmp_path / "x.mcap")]) == exit_status.BAD_INPUT
    )
    assert "nowhere: no run" in capsys.readouterr().err


# ---- links


def frames(*rows):
    found = np.zeros(len(rows), FRAME_LOG)
    for k, row in enumerate(rows):
        for name, value in row.items():
            found[name][k] = value
    return found


def test_a_link_has_its_worst_outcome_until_it_is_taken():
    table = links.LinkTable(4)
    table.add_frames(
        frames(
            {"end_ns": 10, "source": 2, "destination": 0, "kind": b"ftm", "delivered": 1},
            {"end_ns": 20, "source": 0, "destination": 2, "kind": b"data", "collided": 1},
            {"end_ns": 20, "source": 3, "destination": 1, "kind": b"ack", "lost_to_noise": 1},
            {"end_ns": 30, "source": 0, "destination": 2, "kind": b"data", "delivered": 1},
            {"end_ns": 40, "source": 1, "destination": -1, "kind": b"data", "delivered": 2, "collided": 1},
        )
    )
    expected = np.zeros((4, 4))
    expected[0, 2], expected[1, 3] = links.COLLIDED, links.NOISE
    assert np.array_equal(table.take(20), expected)
    expected = np.zeros((4, 4))
    expected[0, 2], expected[0, 1], expected[1, 2], expected[1, 3] = links.DELIVERED, *[links.PARTLY] * 3
    assert np.array_equal(table.take(40), expected)
    assert not table.take(50).any()
