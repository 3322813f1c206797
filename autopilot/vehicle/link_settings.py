"""What the links of one vehicle share: the key of their signatures, and the log of the ground link."""

from pathlib import Path

from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.signing import Signer, SigningStreams, key_of
from autopilot.mavlink.tlog import TelemetryLog
from autopilot.parameters.config import VehicleConfig


class LinkSettings:
    """Encoders and signers of a vehicle's links. Raises OSError and SigningKeyError for its key file."""

    def __init__(self, config: VehicleConfig) -> None:
        path = config.links.signing_key_file
        self._key = None if path is None else key_of(Path(path).read_bytes())
        self._received = SigningStreams()
        self._system = config.instance + 1

    def encoder(self) -> Encoder:
        """Return the encoder of a link."""
        return Encoder(system=self._system, component=AUTOPILOT_COMPONENT)

    def signer(self, link: int) -> Signer | None:
        """Return the signer of the link of that number; None without a key."""
        return None if self._key is None else Signer(self._key, link_id=link, received=self._received)


def ground_log(config: VehicleConfig) -> TelemetryLog | None:
    """Return the new log of the ground link if there is one. Raises OSError."""
    if not config.logging.tlog or config.params_path is None:
        return None
    path = Path(config.params_path).with_name(f"ground-{config.instance}.tlog")
    return TelemetryLog(path, epoch_unix_us=config.epoch_unix_us)
