"""Bits of the simulator's link by which a vehicle and the time master tell each other of the radio.

The radio's batches go another way than the step's messages. Who waits for one has to know that it comes.
"""

BATCH_HANDED_OVER = 1 << 32
"""Bit of HIL_ACTUATOR_CONTROLS.flags, free in the standard: the vehicle gave its radio something to send."""
BATCH_DELIVERED = 1 << 30
"""Bit of HIL_SENSOR.fields_updated, free in the standard: the radio has brought something for this step."""
