"""MAVLink services without I/O, each of the shape of `service.Service`; one set per link."""
