"""The display of a campaign: done of total, rate, failures, elapsed and remaining time."""

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import SCENARIOS
from rich.console import Console

from harness.campaign import Campaign, Landed
from harness.campaign import display as display_module
from harness.campaign.definition import expand
from harness.campaign.display import CampaignDisplay, CampaignPace
from harness.campaign.store import FAILED, Flown


@given(
    each_s=st.floats(0.1, 1e4), start_s=st.floats(0.0, 1e3), total=st.integers(4, 1000), data=st.data(),
)  # fmt: skip
def test_the_remaining_time_is_extrapolated_from_the_rate_so_far(each_s, start_s, total, data):
    """One run every ``each_s``, the first later: after k of n the time of (n - k) remains, counting down."""
    pace = CampaignPace(5.0)
    assert pace.left_s(5.0) is None
    done = data.draw(st.integers(4, total))
    for number in range(1, done + 1):
        now_s = 5.0 + start_s + number * each_s
        pace.landed(total, now_s)
    about = {"rel": 1e-6, "abs": 1e-6 * total}
    assert pace.left_s(now_s) == pytest.approx((total - done) * each_s, **about)
    later_s = max(0.0, (total - done - 0.5) * each_s)
    assert pace.left_s(now_s + each_s / 2) == pytest.approx(later_s, **about)
    assert pace.left_s(now_s + 2 * total * each_s) == 0.0


def test_the_rate_and_the_real_time_factor_are_those_of_all_workers():
    pace = CampaignPace(0.0)
    pace.landed(8, 100.0, 30.0)  # compiles
    assert (pace.per_minute, pace.factor, pace.rate_text()) == (None, None, "")
    pace.landed(8, 120.0, 30.0)
    assert pace.rate_text() == "1.0 per min, 0.5 x real time"
    for number in range(2, 8):
        pace.landed(8, 100.0 + 20.0 * number, 30.0)
    assert pace.rate_text() == "3.0 per min, 1.5 x real time"  # without the first run
    assert pace.elapsed_s(170.0) == 170.0


def test_without_simulated_times_there_is_no_real_time_factor():
    pace = CampaignPace(0.0)
    for number in range(4):
        pace.landed(8, 20.0 * (number + 1))
    assert pace.rate_text() == "3.0 per min"


def landings(console, monkeypatch, *, total, kept=0):
    """Show a campaign whose second run fails, one run every 30 s of wall time; returns what is shown."""
    wall_s = 1_000.0
    monkeypatch.setattr(display_module.time, "monotonic", lambda: wall_s)
    campaign = Campaign(name="windy", scenario=SCENARIOS / "article.toml", seeds=tuple(range(1, total + 1)))
    runs = expand(campaign, state="")
    with CampaignDisplay(console, campaign, total=total + kept, kept=kept) as display:
        for done in range(1, total):
            wall_s += 30.0
            run = runs[done - 1]
            ended = {"status": FAILED, "reason": "no x"} if done == 2 else {"status": "completed"}
            flown = Flown(digest=run.digest, summary={"simulated_s": 45.0}, **ended)
            display.on_landed(Landed(run=run, flown=flown, done=done, total=total))
        display._progress.refresh()
        return console.file.getvalue()


def test_lines_of_a_campaign_have_done_of_total_rate_failures_and_times(monkeypatch):
    lines = landings(Console(file=io.StringIO(), width=80), monkeypatch, total=5).splitlines()
    assert lines[0] == "1 of 5 flown, 30 s elapsed, ? left"
    assert lines[1] == "windy, seed 2: no x"
    assert lines[-1] == (
        "4 of 5 flown, 2.0 per min, 1.5 x real time, 1 failed, 2 min 00 s elapsed, 30 s left"
    )


@pytest.mark.parametrize("width", [80, 120])
def test_the_bar_of_a_campaign_fits_the_width_and_counts_stored_runs(monkeypatch, width):
    console = Console(file=io.StringIO(), width=width, force_terminal=True)
    shown = landings(console, monkeypatch, total=5, kept=3)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown).replace("\r", "\n")
    bar, state = plain.rstrip().splitlines()[-2:]
    assert bar.startswith("windy ━")
    assert bar.rstrip().endswith(" 7/8")
    assert state.rstrip() == "2.0 per min, 1.5 x real time, 1 failed, 2 min 00 s elapsed, 30 s left"
    assert max(len(bar), len(state)) <= width
