"""MAVLink services without I/O, each with the interface `service.Service`; one instance per vehicle."""
