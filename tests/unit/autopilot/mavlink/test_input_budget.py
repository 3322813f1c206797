"""Budget of received frames: rates in simulated or wall time, bursts, partners beside each other."""

from autopilot.mavlink.input_budget import (
    BURST_S,
    LINK_FRAMES_S,
    MOST_PARTNERS,
    PARTNER_FRAMES_S,
    InputBudget,
)

SECOND_US = 1_000_000
PARTNER, OTHER = ("127.0.0.1", 1), ("127.0.0.1", 2)


def read(budget, partner, datagrams, frames=1):
    """Return how many of a partner's datagrams are read."""
    count = 0
    for _ in range(datagrams):
        if budget.admits(partner):
            budget.spend(partner, frames)
            count += 1
    return count


def begun(**rates):
    budget = InputBudget(**rates)
    budget.advance(0, 0)
    return budget


def test_a_burst_and_then_the_rate_are_read_in_simulated_time():
    budget = begun()
    assert read(budget, PARTNER, 5_000) == PARTNER_FRAMES_S * BURST_S
    for step in range(1, 51):  # 1 s, in which 15 000 arrive
        budget.advance(step * 20_000, step * 100)
        assert read(budget, PARTNER, 300) == PARTNER_FRAMES_S // 50
    budget.advance(10 * SECOND_US, 5_000)
    assert read(budget, PARTNER, 5_000) == PARTNER_FRAMES_S * BURST_S


def test_wall_time_fills_the_budget_while_simulated_time_rests():
    budget = begun()
    read(budget, PARTNER, 5_000)
    for step in range(1, 11):
        budget.advance(0, step * 100_000)
        assert read(budget, PARTNER, 300) == PARTNER_FRAMES_S // 10


def test_the_two_times_are_not_added():
    budget = begun()
    read(budget, PARTNER, 5_000)
    budget.advance(100_000, 100_000)
    assert read(budget, PARTNER, 300) == PARTNER_FRAMES_S // 10
    budget.advance(200_000, 150_000)
    assert read(budget, PARTNER, 300) == PARTNER_FRAMES_S // 10


def test_frames_count_and_a_datagram_that_begins_within_the_budget_is_read_whole():
    budget = begun(partner_frames_s=100)
    assert read(budget, PARTNER, 10, frames=60) == 2
    budget.advance(200_000, 0)  # pays the debt of 20
    assert read(budget, PARTNER, 10, frames=60) == 0
    budget.advance(210_000, 0)
    assert read(budget, PARTNER, 10, frames=60) == 1


def test_a_datagram_without_a_frame_counts_too():
    assert read(begun(partner_frames_s=100), PARTNER, 300, frames=0) == 100


def test_apparent_frames_cost_less_than_messages():
    budget = begun(partner_frames_s=100)
    for _ in range(4):
        assert budget.admits(PARTNER)
        budget.spend(PARTNER, 5, rejected_frames=160)  # 25
    assert not budget.admits(PARTNER)


def test_a_flood_of_one_partner_leaves_the_others_theirs():
    budget = begun()
    read(budget, PARTNER, 5_000)
    for step in range(1, 101):
        budget.advance(step * 20_000, 0)
        read(budget, PARTNER, 300)
        assert read(budget, OTHER, 5) == 5


def test_many_addresses_together_have_the_budget_of_the_link():
    budget = begun()
    senders = [("127.0.0.1", port) for port in range(4 * MOST_PARTNERS)]
    assert sum(read(budget, sender, 100) for sender in senders) == LINK_FRAMES_S * BURST_S
    assert len(budget._partners) <= MOST_PARTNERS
    budget.advance(SECOND_US // 10, 0)
    assert sum(read(budget, sender, 100) for sender in senders) == LINK_FRAMES_S // 10
