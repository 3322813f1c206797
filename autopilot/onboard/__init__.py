"""The application beside each autopilot: beacons, ranging, localisation, formation control. No I/O.

`application.Application` is the interface that the vehicle requires; `app.OnboardApp` is the built-in one and
composes the rooms. An application exchanges MAVLink messages with its autopilot, and datagrams and ranging
requests with its radio, nothing else. It can therefore also run on a companion computer beside a PX4.
"""
