"""MAVLink component numbers of what a vehicle is made of."""

from pymavlink.dialects.v20 import common

AUTOPILOT_COMPONENT = int(common.MAV_COMP_ID_AUTOPILOT1)
APPLICATION_COMPONENT = int(common.MAV_COMP_ID_ONBOARD_COMPUTER)
