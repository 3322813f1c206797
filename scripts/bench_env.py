"""Measure environments for learning: ``python scripts/bench_env.py [--agents 8] [--steps 1000] [--json]``.

Prints the time of the first reset, which flies the swarm to its places, that of later resets, and the steps
of an environment per second of wall time, with random velocities; each UAV sends 5 beacons and ranges 5 times
a second.
"""

import argparse
import json
import time

import numpy as np

import coflight.env

RESETS = 20


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Measure environments for learning.")
    parser.add_argument("--agents", type=int, default=8, help="Number of UAVs.")
    parser.add_argument("--steps", type=int, default=1000, help="Steps that are measured.")
    parser.add_argument("--json", action="store_true", help="Print JSON.")
    arguments = parser.parse_args()
    overrides = ["formation.columns=1", f"formation.rows={arguments.agents}"] if arguments.agents != 8 else []
    env = coflight.env.parallel_env(
        "article", agents=arguments.agents, overrides=overrides, duration_s=10.0, speed_max_m_s=1.0
    )
    begin_s = time.perf_counter()
    env.reset(seed=0)
    first_s = time.perf_counter() - begin_s
    resets_s = []
    for seed in range(RESETS):
        begin_s = time.perf_counter()
        env.reset(seed=seed)
        resets_s.append(time.perf_counter() - begin_s)
    rng, steps, wall_s = np.random.default_rng(0), 0, 0.0
    while steps < arguments.steps:
        if not env.agents:
            env.reset()
        actions = {agent: rng.uniform(-1.0, 1.0, 3) for agent in env.agents}
        begin_s = time.perf_counter()
        env.step(actions)
        wall_s += time.perf_counter() - begin_s
        steps += 1
    env.close()
    results = {
        "agents": arguments.agents,
        "first_reset_s": round(first_s, 2),
        "reset_median_ms": round(1e3 * float(np.median(resets_s)), 1),
        "reset_greatest_ms": round(1e3 * max(resets_s), 1),
        "steps_per_s": round(steps / wall_s, 1),
        "agent_steps_per_s": round(steps * arguments.agents / wall_s, 1),
    }
    print(json.dumps(results) if arguments.json else "\n".join(f"{k}: {v}" for k, v in results.items()))


if __name__ == "__main__":
    main()
