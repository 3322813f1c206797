"""MAVLink component ids of a vehicle's components."""

from pymavlink.dialects.v20 import common

AUTOPILOT_COMPONENT = int(common.MAV_COMP_ID_AUTOPILOT1)
APPLICATION_COMPONENT = int(common.MAV_COMP_ID_ONBOARD_COMPUTER)
