"""The models of one run's radio, as `netsim.radio_models.registry` selects them.

Built-in models with a faster or a combined computation are classes of their own; all others implement a
protocol of `netsim.phy.interfaces`.
"""

from collections.abc import Mapping

from msgspec import Struct

from netsim.phy.antenna import Dipole
from netsim.phy.fading import RicianFading, SampledFading
from netsim.phy.interfaces import AntennaPattern, ErrorModel, PathLoss, Shadowing
from netsim.phy.path_loss import PowerLaw, TwoRay


class RadioModels(Struct, frozen=True, kw_only=True):
    """One model of each kind."""

    path_loss: PathLoss | PowerLaw | TwoRay
    antenna: AntennaPattern | Dipole | None
    """None: isotropic."""
    own_antennas: Mapping[int, AntennaPattern | Dipole | None] = {}
    """Those of stations that have another one, by number."""
    shadowing: Shadowing | None
    fading: RicianFading | SampledFading | None
    error_model: ErrorModel
