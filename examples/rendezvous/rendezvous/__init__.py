"""Consensus rendezvous over beacons; `application.Rendezvous` is the on-board application."""
