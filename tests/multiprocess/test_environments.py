"""Environments for learning with their processes: the APIs' own tests, seeds, ends, errors."""

import contextlib
import gc
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from env_swarms import PERIOD_S, small
from msgspec.structs import replace

import coflight.env
from autopilot.parameters.onboard_config import ProgramConfig
from coflight import SwarmError
from foundation.extension_failure import ExtensionFailure
from harness.env.client import Client

pettingzoo_tests = pytest.importorskip("pettingzoo.test", reason="the extra coflight[env] is not installed")
env_checker = pytest.importorskip("gymnasium.utils.env_checker")

pytestmark = pytest.mark.multiprocess
END_S = 10.0


def swarm_env(agents=2, duration_s=1.0, reward=coflight.env.hold_place, **settings):
    scenario, _ = small(agents)
    return coflight.env.parallel_env(scenario, duration_s=duration_s, reward=reward, **settings)


@contextlib.contextmanager
def closing(env):
    try:
        yield env
    finally:
        env.close()


def await_end(pids):
    deadline_s = time.monotonic() + END_S
    while (left := [pid for pid in pids if is_running(pid)]) and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert not left


def is_running(pid):
    with contextlib.suppress(psutil.NoSuchProcess):
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    return False


def fly(env, seed, steps, action=0.2):
    """Return all observations of an episode (steps + 1, N, O)."""
    observations, _ = env.reset(seed=seed)
    rows = [np.array([*observations.values()])]
    for _ in range(steps):
        observations, *_ = env.step(
            {agent: np.full(env.action_space(agent).shape, action) for agent in env.agents}
        )
        rows.append(np.array([*observations.values()]))
    return np.array(rows)


def test_the_tests_of_pettingzoo_pass():
    with closing(swarm_env(message_size=2, radio="chosen")) as env:
        pettingzoo_tests.parallel_api_test(env, num_cycles=60)
    pettingzoo_tests.parallel_seed_test(swarm_env, num_cycles=20)


@pytest.mark.filterwarnings("default")
def test_the_check_of_gymnasium_passes():
    scenario, _ = small()
    with closing(coflight.env.single_env(scenario, duration_s=1.0, setpoint="acceleration")) as env:
        env_checker.check_env(env, skip_render_check=True)


def test_equal_seeds_repeat_an_episode_and_others_change_wind_sensors_and_radio():
    with closing(swarm_env(duration_s=5.0)) as env:
        first, again, other = fly(env, 3, 50), fly(env, 3, 50), fly(env, 4, 50)
        names = env.observation_names
    np.testing.assert_array_equal(first, again)
    for name in ("pos_n_m", "vel_n_m_s", "next_1_range_m", "next_1_pos_n_m"):
        column = names.index(name)
        assert np.all(first[-1, :, column] != other[-1, :, column])
    with closing(swarm_env(duration_s=5.0)) as env:  # another flight to the same places
        np.testing.assert_array_equal(fly(env, 3, 50), first)


def test_seeds_that_are_drawn_continue_from_the_last_one_given():
    with closing(swarm_env()) as env:
        seeds = [env.reset(seed=5)[1]["uav_0"]["seed"], *(env.reset()[1]["uav_0"]["seed"] for _ in range(3))]
        assert [env.reset(seed=5)[1]["uav_0"]["seed"], env.reset()[1]["uav_0"]["seed"]] == seeds[:2]
    assert len(set(seeds)) == 4


def test_observations_keep_their_bounds_under_any_actions():
    rng = np.random.default_rng(1)
    with closing(swarm_env(duration_s=4.0, speed_max_m_s=20.0)) as env:
        observations, _ = env.reset(seed=1)
        while env.agents:
            assert all(env.observation_space(agent).contains(row) for agent, row in observations.items())
            observations, *_ = env.step({agent: rng.uniform(-3.0, 3.0, 3) for agent in env.agents})


def test_velocity_and_acceleration_move_a_uav_as_told():
    for setpoint, expected_m_s in (("velocity", 1.0), ("acceleration", 1.0)):
        states = []
        with closing(
            swarm_env(reward=lambda s, keep=states: keep.append(s) or np.zeros(2), duration_s=9.0,
                      setpoint=setpoint, speed_max_m_s=2.0, acc_max_m_s2=1.0)
        ) as env:  # fmt: skip
            fly(env, 1, 50, action=np.array([0.5, 0.0, -0.0]))
        change = states[-1].vel_ned_m_s - states[0].vel_ned_m_s
        assert np.all(np.abs(change[:, 0] - expected_m_s) < 0.5), setpoint
        assert np.all(np.abs(states[-1].vel_ned_m_s[:, 2]) < 0.5)


def test_messages_reach_the_others_in_beacons():
    with closing(swarm_env(message_size=1, duration_s=5.0)) as env:
        env.reset(seed=1)
        for _ in range(15):
            observations, *_ = env.step({"uav_0": [0, 0, 0, 0.75], "uav_1": [0, 0, 0, -0.25]})
        column = env.observation_names.index("next_1_message_0")
        assert [row[column] for row in observations.values()] == [-0.25, 0.75]


def test_a_radio_that_actions_control_is_silent_without_them():
    with closing(swarm_env(radio="chosen", duration_s=9.0)) as env:
        beacon, ranged = (env.observation_names.index(f"next_1_{name}_age_s") for name in ("beacon", "range"))
        env.reset(seed=1)
        for _ in range(50):
            observations, *_ = env.step({"uav_0": [0, 0, 0, 1, -1], "uav_1": [0, 0, 0, -1, 1]})
        assert observations["uav_0"][beacon] > 1.9  # uav_1 sent none in two seconds
        assert observations["uav_1"][beacon] < 0.2
        assert observations["uav_0"][ranged] > 1.9
        assert observations["uav_1"][ranged] < 0.2


def test_a_uav_that_flies_into_the_ground_ends_and_the_other_goes_on():
    with closing(swarm_env(duration_s=8.0, speed_max_m_s=4.0)) as env:
        env.reset(seed=1)
        ended = False
        while not ended:
            assert env.agents == ["uav_0", "uav_1"]
            _, rewards, terminations, truncations, infos = env.step({"uav_1": [0.0, 0.0, 1.0]})
            ended = terminations["uav_1"]
        assert not terminations["uav_0"]
        assert not truncations["uav_1"]
        assert infos["uav_1"]["reason"] == "touched the ground"
        assert rewards["uav_1"] < -100.0 < rewards["uav_0"]
        while env.agents:
            assert env.agents == ["uav_0"]
            *_, terminations, truncations, _ = env.step({"uav_0": np.zeros(3)})
        assert (terminations, truncations) == ({"uav_0": False}, {"uav_0": True})
        with pytest.raises(SwarmError, match="reset comes before step"):
            env.step({})


def test_uavs_that_collide_end_with_each_others_name():
    scenario, _ = small(overrides=['sensors.profile="ideal"', "wind.mean_n=0"])
    north_m = scenario.places_ned_m()[:, 0]
    towards = float(np.sign(north_m[1] - north_m[0]))
    with closing(coflight.env.parallel_env(scenario, duration_s=20.0)) as env:
        env.reset(seed=1)
        while env.agents:
            *_, infos = env.step({"uav_0": [0.5 * towards, 0.0, 0.0], "uav_1": [-0.5 * towards, 0.0, 0.0]})
    assert infos == {f"uav_{i}": {"reason": f"collided with uav {1 - i}"} for i in range(2)}


def test_other_uavs_follow_their_policy():
    scenario, _ = small()
    states = []

    def reward(state):
        states.append(state)
        return np.zeros(2)

    env = coflight.env.single_env(
        scenario, uav=1, others=lambda _: np.array([0.0, 1.0, 0.0]), reward=reward, duration_s=2.0
    )
    with closing(env):
        env.reset(seed=1)
        truncated = False
        while not truncated:
            _, _, _, truncated, _ = env.step(np.zeros(3))
    assert states[-1].vel_ned_m_s[0, 1] > 1.0
    assert abs(states[-1].vel_ned_m_s[1, 1]) < 1.0
    assert states[-1].time_s == pytest.approx(50 * PERIOD_S)


def test_an_exception_in_a_reward_is_one_line_that_names_it():
    def my_reward(_):
        return 1.0 / 0.0

    with closing(swarm_env(reward=my_reward)) as env:
        env.reset(seed=1)
        with pytest.raises(
            ExtensionFailure, match=r"my_reward: ZeroDivisionError: .*test_environments\.py:\d+"
        ):
            env.step({})
    with closing(swarm_env(reward=lambda _: [1.0])) as env:
        env.reset(seed=1)
        with pytest.raises(ExtensionFailure, match="expected 2 finite numbers"):
            env.step({})


def test_wrong_actions_and_settings_are_refused():
    with closing(swarm_env()) as env:
        env.reset(seed=1)
        for actions, text in (
            ({"uav_7": np.zeros(3)}, "uav_7.*expected one of uav_0, uav_1"),
            ({"uav_0": np.zeros(2)}, "uav_0.*expected 3 numbers"),
            ({"uav_0": [np.nan, 0.0, 0.0]}, "expected 3 numbers"),
        ):
            with pytest.raises(ValueError, match=text):
                env.step(actions)
        with pytest.raises(ValueError, match="seed: -1"):
            env.reset(seed=-1)
    for settings, text in (
        ({"duration_s": 0.0}, "duration_s"), ({"setpoint": "thrust"}, "setpoint"), ({"speed": 1}, "speed"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            swarm_env(**settings)


def test_processes_end_with_close_with_a_new_episode_and_with_the_object():
    env = swarm_env()
    assert env.pids == ()
    env.reset(seed=1)
    server, first = env.pids
    env.reset(seed=2)
    await_end([first])
    assert env.pids[0] == server
    pids = env.pids
    env.close()
    env.close()
    await_end(pids)
    env.reset(seed=1)  # starts again
    pids = env.pids
    del env
    gc.collect()
    await_end(pids)


def test_the_death_of_an_episode_or_its_server_is_one_line_and_a_reset_goes_on():
    with closing(swarm_env()) as env:
        env.reset(seed=1)
        os.kill(env.pids[1], signal.SIGKILL)
        with pytest.raises(SwarmError, match=r"^env: the episode's process \d+ was killed by SIGKILL$"):
            env.step({})
        env.reset(seed=1)
        env.step({})
        server, episode = env.pids
        os.kill(server, signal.SIGKILL)
        await_end([episode])  # it ends with its server
        with pytest.raises(SwarmError, match="the server of the swarm was killed by SIGKILL"):
            env.step({})
        env.reset(seed=1)
        env.step({})


PROGRAM = """
import sys
import coflight.env
from env_swarms import small
env = coflight.env.parallel_env(small()[0])
env.reset(seed=1)
print(*env.pids, flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("stopped", [False, True])
def test_processes_end_when_the_program_is_killed(stopped):
    support = Path(__file__).parents[1] / "support"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(support), *sys.path])}
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    with program:
        pids = [int(word) for word in program.stdout.readline().split()]
        if stopped:  # they cannot read that their input has ended
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
        program.kill()
    assert len(pids) == 2
    await_end(pids)


def test_a_fork_of_the_program_does_not_end_the_episode():
    with closing(swarm_env()) as env:
        env.reset(seed=1)
        process = multiprocessing.get_context("fork").Process(target=env.close)
        process.start()
        process.join()
        env.step({})


def test_a_program_of_the_user_that_raises_ends_its_uav():
    scenario, settings = small()
    client = Client(failing(scenario))
    with contextlib.closing(client):
        with pytest.raises(SwarmError, match=r"uav 1: onboard.programs\[0\].* ZeroDivisionError: as written"):
            client.reset(1)
        assert client.pids == ()
    assert settings.message_size == 0


def failing(scenario):
    program = ProgramConfig(name="other", application="user_applications:Raises", port=50_900)
    return replace(scenario, onboard=replace(scenario.onboard, programs=(program,)))
