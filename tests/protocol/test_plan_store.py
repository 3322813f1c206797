"""Stored plans: bit-exact content and opaque ids."""

import math
import struct

import numpy as np
import pytest

from autopilot.navigation.plan_store import PlanStore, PlanType, WireItem, make_plan, opaque_id

ITEM = WireItem(16, 6, (0.0, math.nan, -0.0, 3.5), 473_979_710, 85_455_940, 12.25)


@pytest.mark.parametrize("field", WireItem._fields)
def test_an_opaque_id_depends_on_every_field(field):
    value = getattr(ITEM, field)
    other = (1.0, *value[1:]) if field == "params" else value + 1
    assert opaque_id([ITEM]) != opaque_id([ITEM._replace(**{field: other})])


def test_an_opaque_id_depends_on_order_and_number_and_signs_of_zero():
    other = ITEM._replace(x=0)
    ids = {
        opaque_id(items)
        for items in ([ITEM], [other], [ITEM, other], [other, ITEM], [ITEM, ITEM], [ITEM._replace(z=-0.0)])
    }
    assert len(ids) == 6
    assert opaque_id([]) == 0


def test_an_opaque_id_is_px4s_crc():
    """Bitwise: polynomial 0xEDB88320 from 0, over frame, command, autocontinue and seven values."""
    data = struct.pack("<BHB4fiif", 6, 16, 1, *ITEM.params, ITEM.x, ITEM.y, ITEM.z)
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB8_8320 if crc & 1 else 0)
    assert opaque_id([ITEM]) == crc


def test_the_version_changes_only_with_the_content():
    store = PlanStore()
    assert store.put(PlanType.MISSION, [ITEM, ITEM], start=1)
    assert not store.put(PlanType.MISSION, [ITEM, ITEM])  # NaN is equal to itself here
    assert (store.version[PlanType.MISSION], store[PlanType.MISSION].start) == (1, 1)
    assert store.put(PlanType.MISSION, ())
    assert not store.put(PlanType.MISSION, ())
    assert store.version == {PlanType.MISSION: 2, PlanType.FENCE: 0, PlanType.RALLY: 0}


def test_a_plan_is_a_copy_of_its_items():
    items = [ITEM]
    plan = make_plan(items)
    items.append(ITEM)
    assert len(plan.items) == 1


def test_random_plans_have_different_ids():
    rng = np.random.default_rng(5)
    ids = {
        opaque_id([ITEM._replace(x=int(rng.integers(-9e8, 9e8)), y=int(rng.integers(-18e8, 18e8)))])
        for _ in range(2_000)
    }
    assert len(ids) == 2_000  # a collision among 2,000 has probability 5e-4
