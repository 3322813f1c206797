"""Attacks on flying runs from outside: other users and the run's own user at ports, sockets, files and slots.

Import `cli`. Each section flies a seed beside a program that attacks (`attack_program`), flies it again
without, and compares hashes, manifests and memory (`comparison`).
"""
