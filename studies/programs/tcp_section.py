"""TCP over a link that loses frames, with and without retries of the MAC."""

from functools import partial

import numpy as np
from msgspec import Struct

from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.programs.flight import (
    LATENESS_COLUMN,
    NO_APPLICATION,
    Lateness,
    data_frames,
    fly,
    iperf_report,
    program,
    run_until_report,
    until_success,
)
from studies.programs.plan import ProgramsPlan

LOSS = 0.1
MODE = "ofdm12"
SEGMENT_IP_BYTES = 1_500
RETRY_LIMIT = 6
CASES = ((0.0, RETRY_LIMIT), (LOSS, RETRY_LIMIT), (LOSS, 0))
"""Loss of frames, and retry limit"""
LEAST_WITH_RETRIES = 0.75
"""Goodput over that without losses"""
MOST_WITHOUT_RETRIES = 0.95
"""Goodput over that with retries: a tenth of the air time carries lost frames, and TCP waits beside"""
MOST_SEGMENTS_REPAIRED, LEAST_SEGMENTS_REPAIRED = 0.01, 0.08
"""Segments that TCP sends again over frames, with and without retries"""
_GROUP = "tcp"


class Transfer(Struct, frozen=True, kw_only=True):
    """Results of one transfer."""

    loss: float
    retry_limit: int
    goodput_mbps: float
    """As the receiver has reported"""
    retransmitted_segments: int
    """By TCP"""
    frames: int
    """Transmissions of full segments"""
    lost_fraction: float
    """Of these, by noise"""
    lateness: Lateness


def jobs(plan: ProgramsPlan) -> dict[str, list[Job]]:
    """Return one job for each case."""
    return {_GROUP: [partial(measure, loss, limit, plan.tcp_wall_s) for loss, limit in CASES]}


def scenario(loss: float, retry_limit: int, wall_s: float) -> str:
    """Return the scenario: one vehicle sends to the other by TCP for ``wall_s``."""
    text = f"""agents = 2
[formation]
shape = "line"
[radio]
bandwidth_mhz = 20
path_loss = "studies.programs.radio_models:equal_loss"
fading = "none"
data_mode = "{MODE}"
control_mode = "{MODE}"
broadcast_mode = "{MODE}"
broadcast_rts = false
retry_limit = {retry_limit}
{NO_APPLICATION}"""
    if loss > 0.0:
        settings = f"{{ fraction = {loss}, frame_bytes = {SEGMENT_IP_BYTES + 36} }}"
        text += f"""[radio.error_model]
model = "studies.programs.radio_models:FrameLoss"
settings = {settings}
"""
    client = ("iperf3", "--client", "10.1.0.1", "--time", round(wall_s), "--json")
    text += program("server", 1, ("iperf3", "--server", "--one-off", "--json"))
    return text + program("client", 0, until_success(*client))


def measure(loss: float, retry_limit: int, wall_s: float) -> Transfer:
    """Fly one case. Raises SwarmError."""
    text = scenario(loss, retry_limit, wall_s)
    limit_s = 3.0 * wall_s + 20.0
    flown = fly(
        text, speed=1.0, seed=1, course=lambda swarm: run_until_report(swarm, 0, "client", limit_s=limit_s)
    )
    end = iperf_report(flown.logs[0, "client"])["end"]
    segments = data_frames(flown.frames, SEGMENT_IP_BYTES, source=0, to=1)
    return Transfer(
        loss=loss,
        retry_limit=retry_limit,
        goodput_mbps=end["sum_received"]["bits_per_second"] * 1e-6,
        retransmitted_segments=end["sum_sent"]["retransmits"],
        frames=int(np.count_nonzero(segments)),
        lost_fraction=float(np.mean(flown.frames["lost_to_noise"][segments] > 0)),
        lateness=flown.lateness,
    )


def judge(plan: ProgramsPlan, results: Results) -> Section:
    """Compare the goodput with and without losses and retries."""
    clean, retried, bare = found = results[_GROUP]
    return Section(
        title="TCP over a link that loses frames",
        conditions=filled(
            f"`iperf3` by TCP (the kernel's congestion control) between two vehicles for "
            f"{plan.tcp_wall_s:g} s at speed 1 and mode {MODE}. An error model of one's own loses "
            f"{100 * LOSS:.0f} % of the frames with full segments, and 0.6 % of those with an "
            "acknowledgement of TCP alone, at any SNR. Without retries TCP repairs the losses itself: how "
            "well depends on the round trip, which the machine lengthens."
        )
        + "\n",
        checks=(
            Check.near("frames lost by noise", retried.lost_fraction, LOSS, 0.15),
            Check(
                f"retry limit {RETRY_LIMIT}: goodput, share of that without losses",
                retried.goodput_mbps / clean.goodput_mbps,
                at_least=LEAST_WITH_RETRIES,
            ),
            Check(
                "no retries: goodput, share of that with retries",
                bare.goodput_mbps / retried.goodput_mbps,
                at_most=MOST_WITHOUT_RETRIES,
            ),
            Check(
                f"retry limit {RETRY_LIMIT}: segments that TCP repeats, share of the frames",
                retried.retransmitted_segments / retried.frames,
                at_most=MOST_SEGMENTS_REPAIRED,
            ),
            Check(
                "no retries: segments that TCP repeats, share of the frames",
                bare.retransmitted_segments / bare.frames,
                at_least=LEAST_SEGMENTS_REPAIRED,
            ),
        ),
        tables=(
            ReportTable(
                caption="Transfers.",
                columns=(
                    "frames lost", "retry limit", "goodput, Mbit/s", "TCP retransmissions",
                    "frames of full segments", LATENESS_COLUMN,
                ),
                rows=tuple(
                    (
                        f"{100 * each.lost_fraction:.1f} %",
                        str(each.retry_limit),
                        f"{each.goodput_mbps:.2f}",
                        str(each.retransmitted_segments),
                        str(each.frames),
                        each.lateness.text,
                    )
                    for each in found
                ),
            ),
        ),
    )  # fmt: skip
