"""Environments for learning and search: a swarm in the air, stepped by actions of the user's policies.

`coflight.env` is the public face. `parallel` and `single` are the environments of PettingZoo and Gymnasium,
the only modules that import them. They use `client`, which talks to the process of `server`: that flies the
swarm to its places once and forks a process for each `episode`.
"""
