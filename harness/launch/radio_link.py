"""How the processes of a run, and programs outside it, reach the 802.11 emulator: endpoint and passwords.

An I/O module.
"""

import contextlib
from pathlib import Path

from autopilot.parameters.config import RadioEndpoint
from harness.records.run_folder import RunFolder
from harness.scenario import stations as ground_stations
from harness.scenario.scenario import Scenario
from netsim.model.config import ServerConfig
from netsim.transport.guest_access import GuestLogin, write_guest_access
from netsim.transport.radio_users import guest_user, new_passwords
from netsim.transport.socket_folder import SOCKET, SocketFolder


class RadioLink:
    """The socket folder of a run's radio, its passwords, and the file for its guests; to be removed.

    Raises OSError if there is no folder for the socket.
    """

    def __init__(self, scenario: Scenario, folder: RunFolder, *, run_id: str) -> None:
        self._guest_access = folder.guest_access
        self._socket_folder = SocketFolder() if scenario.ports.radio_link == "unix" else None
        path = None if self._socket_folder is None else str(self._socket_folder.path / SOCKET)
        self._guests = len(scenario.radio.guests)
        self._stations = ground_stations.numbers(scenario.ground_stations, scenario.radio, scenario.agents)
        passwords = new_passwords(self._guests + len(self._stations), packets=scenario.has_network)
        self.config: ServerConfig = folder.radio_config(
            scenario, run_id=run_id, socket_path=path, passwords=passwords
        )
        """Settings of the emulator's process."""
        self._passwords = passwords
        self.endpoint: RadioEndpoint | None = None
        """What vehicles connect to, once the emulator is ready."""
        self.packets_endpoint: RadioEndpoint | None = None
        """What the process of network interfaces connects to, likewise, if there is one."""

    def open(self, locator: str) -> set[int]:
        """Store the endpoint and write the file for guests if there are any; returns the TCP ports in use.

        Raises OSError.
        """
        self.endpoint = RadioEndpoint(locator=locator, password=self._passwords.vehicles)
        if self._passwords.packets is not None:
            self.packets_endpoint = RadioEndpoint(locator=locator, password=self._passwords.packets)
        if self._guests:
            write_guest_access(self._guest_access, self.config, locator, guests=self._guests)
        return {int(locator.rpartition(":")[2])} if locator.startswith("tcp/") else set()

    def station_login(self, name: str) -> GuestLogin:
        """Return station number, user and password of a ground station."""
        number, of_guests = self._stations[name], self._passwords.guests
        user = guest_user(number, of_guests[self._guests + [*self._stations].index(name)])
        return GuestLogin(station=number, user=user.name, password=user.password)

    def remove(self) -> None:
        """Remove the socket's folder and the guests' file as far as possible; harmless when repeated."""
        if self._socket_folder is not None:
            self._socket_folder.remove()
        with contextlib.suppress(OSError):  # `leftovers` names it
            self._guest_access.unlink()

    def leftovers(self) -> list[Path]:
        """Return what exists after `remove`."""
        paths = [self._guest_access]
        if self._socket_folder is not None:
            paths.append(self._socket_folder.path)
        return [path for path in paths if path.exists()]
